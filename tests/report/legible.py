"""Whether the text of a figure can be read, by the extents that Matplotlib has after drawing."""

from itertools import combinations
from unittest.mock import patch

from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox


def drawn_texts(figure: Figure) -> list[Text]:
    """Return the texts that a figure draws, ticks' labels too."""
    drawn: dict[int, Text] = {}
    draw = Text.draw

    def note(text: Text, renderer: object) -> None:
        drawn[id(text)] = text
        draw(text, renderer)

    with patch.object(Text, "draw", note):
        figure.draw_without_rendering()
    return [text for text in drawn.values() if text.get_visible() and text.get_text().strip()]


def assert_legible(figure: Figure) -> list[tuple[str, Bbox]]:
    """Check that no text of a figure leaves it and no two overlap; return the texts with their boxes in dots."""
    boxes = [(text.get_text(), Text.get_window_extent(text)) for text in drawn_texts(figure)]
    page, pairs = figure.bbox, combinations(boxes, 2)
    cut = [name for name, box in boxes if page.count_contains([box.min, box.max]) < 2]
    assert cut == []
    overlaps = [(a, b) for (a, one), (b, two) in pairs if one.shrunk(0.98, 0.9).overlaps(two)]
    assert overlaps == []
    return boxes
