"""Whether the text of a figure can be read, by the extents that Matplotlib has after drawing."""

from itertools import combinations
from unittest.mock import patch

from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

Boxes = list[tuple[str, Bbox]]


def text_boxes(figure: Figure) -> Boxes:
    """Return the texts that a figure draws, ticks' labels too, with their boxes in dots, without lines to marks."""
    drawn: dict[int, Text] = {}
    draw = Text.draw

    def note(text: Text, renderer: object) -> None:
        drawn[id(text)] = text
        draw(text, renderer)

    with patch.object(Text, "draw", note):
        figure.draw_without_rendering()
    shown = [text for text in drawn.values() if text.get_visible() and text.get_text().strip()]
    return [(text.get_text(), Text.get_window_extent(text)) for text in shown]


def assert_legible(figure: Figure) -> Boxes:
    """Check that no text of a figure leaves it and no two overlap; return the texts with their boxes."""
    boxes, page = text_boxes(figure), figure.bbox
    cut = [name for name, box in boxes if page.count_contains([box.min, box.max]) < 2]
    assert cut == []
    pairs = combinations(boxes, 2)
    assert [(a, b) for (a, one), (b, two) in pairs if one.shrunk(0.98, 0.9).overlaps(two)] == []
    return boxes
