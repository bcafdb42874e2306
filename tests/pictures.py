"""What a reader would find wrong with a picture at first sight, by the extents and colours that Matplotlib draws."""

import re
from base64 import b64decode
from collections.abc import Callable, Iterator
from unittest.mock import patch
from xml.etree.ElementTree import Element, fromstring

import numpy as np
import shapely
from matplotlib.artist import Artist
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection, LineCollection, PathCollection
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import AbstractPathEffect, Normal
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from jaxurban.draw.routes import EDGED

LEAST_PT, LEAST_CONTRAST = 7.0, 1.5  # of letters as printed; by WCAG 2.2, of relative luminances
MM_PER_IN = 25.4
# Of a text's box: lines are boxed from the top of the tallest letter to the foot of the deepest, with or without them.
SIDE_SHARE, FOOT_SHARE = 0.02, 0.1
CUT_PX = 0.5  # that a box may leave the figure by: rounding
PLACES = 200  # of an artist where its contrast is looked at, at most
AROUND = np.array([(-0.5, 0), (0.5, 0), (0, -0.5), (0, 0.5)])  # of a marker, by its size
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

SVG = "{http://www.w3.org/2000/svg}"  # before the name of an element
PICTURE = re.compile(r'<img alt="[^"<>]*" src="data:image/svg\+xml;base64,([\w+/=]+)">')


def pictures_in(html: str) -> list[Element]:
    """Return the pictures of a piece of the viewer's page, as SVG."""
    return [fromstring(b64decode(data)) for data in PICTURE.findall(html)]


def drawn_artists(figure: Figure) -> list[Artist]:
    """Return the texts, lines and collections that a figure draws, those of ticks and legends too, in their order."""
    drawn: dict[int, Artist] = {}

    def noting(draw: Callable) -> Callable:
        def note(artist: Artist, *args: object, **options: object) -> None:
            drawn[id(artist)] = artist
            draw(artist, *args, **options)

        return note

    with (
        patch.object(Text, "draw", noting(Text.draw)),
        patch.object(Line2D, "draw", noting(Line2D.draw)),
        patch.object(LineCollection, "draw", noting(LineCollection.draw)),
        patch.object(PathCollection, "draw", noting(PathCollection.draw)),
    ):
        figure.draw_without_rendering()
    return [artist for artist in drawn.values() if artist.get_visible()]


def drawn_texts(figure: Figure) -> list[Text]:
    """Return the texts that a figure draws, ticks' labels too."""
    texts = [artist for artist in drawn_artists(figure) if isinstance(artist, Text)]
    return [text for text in texts if text.get_text().strip()]


def box_of(text: Text) -> shapely.Polygon:
    """Return the box of a text in dots, turned as the text is."""
    around = Text.get_window_extent(text)
    turn_deg = text.get_rotation()
    if turn_deg % 90 == 0:
        return shapely.box(*around.extents)
    text.set_rotation(0)
    flat = Text.get_window_extent(text)
    text.set_rotation(turn_deg)
    x, y = (around.min + around.max) / 2
    sides = flat.width / 2, flat.height / 2
    box = shapely.box(x - sides[0], y - sides[1], x + sides[0], y + sides[1])
    return shapely.affinity.rotate(box, turn_deg)


def shrunk(text: Text, box: shapely.Polygon) -> shapely.Polygon:
    """Return a text's box without the room that letters leave in it at the sides, the top and the foot."""
    along, across = 1 - SIDE_SHARE, 1 - FOOT_SHARE
    if text.get_rotation() % 180 == 90:
        along, across = across, along
    return shapely.affinity.scale(box, along, across)


def faults(figure: Figure, width_mm: float | None = None) -> list[str]:
    """Return what is wrong with a figure as it is drawn, a sentence each: none is cut, covered, small or pale.

    The figure is drawn twice, and is laid out no more afterwards.

    Args:
      figure: to look at.
      width_mm: at which it is printed; left out, its own. A narrower figure is not made larger.
    """
    artists = drawn_artists(figure)
    texts = [each for each in artists if isinstance(each, Text) and each.get_text().strip()]
    boxes = [box_of(text) for text in texts]
    names = [" ".join(text.get_text().split())[:60] for text in texts]
    return [
        *_cut(figure, texts, boxes, names),
        *_covered(texts, boxes, names),
        *_small(figure, texts, names, width_mm),
        *_pale(figure, artists, dict(zip(map(id, texts), boxes, strict=True))),
    ]


def _cut(figure: Figure, texts: list, boxes: list, names: list) -> Iterator[str]:
    """Yield the texts that leave the figure, or the panel that clips them."""
    page = shapely.box(*figure.bbox.padded(CUT_PX).extents)
    for text, box, name in zip(texts, boxes, names, strict=True):
        room = page
        if text.get_clip_on() and text.get_clip_box() is not None:
            room = shapely.box(*text.get_clip_box().padded(CUT_PX).extents)
        if not room.covers(box):
            yield f"{name!r} is cut"


def _covered(texts: list, boxes: list, names: list) -> Iterator[str]:
    """Yield the pairs of texts that overlap."""
    small = np.array([shrunk(text, box) for text, box in zip(texts, boxes, strict=True)], object)
    for one, other in shapely.STRtree(small).query(small, predicate="intersects").T.tolist():
        if one < other:
            yield f"{names[one]!r} and {names[other]!r} overlap"


def _small(figure: Figure, texts: list, names: list, width_mm: float | None) -> Iterator[str]:
    """Yield the texts that are too small as printed; letters below others, as of a metric's name, do not count."""
    own_mm = figure.get_figwidth() * MM_PER_IN
    scale = min(1.0, (width_mm or own_mm) / own_mm)
    for text, name in zip(texts, names, strict=True):
        size_pt = text.get_size() * scale
        if size_pt < LEAST_PT - 1e-9:
            yield f"{name!r} has {size_pt:.1f} points at {width_mm or own_mm:.0f} mm"


def _pale(figure: Figure, artists: list[Artist], boxes: dict) -> Iterator[str]:
    """Yield what hardly differs from what lies below it at half of its places or more.

    What lies below are images, areas and bars; the ticks and the grid of axes are pale by intent.
    """
    figure.set_layout_engine("none")
    canvas = FigureCanvasAgg(figure)
    with (
        patch.object(Text, "draw", lambda *_: None),
        patch.object(Line2D, "draw", lambda *_: None),
        patch.object(LineCollection, "draw", lambda *_: None),
        patch.object(PathCollection, "draw", lambda *_: None),
    ):
        canvas.draw()
    below = np.asarray(canvas.buffer_rgba())[::-1, :, :3] / 255  # row 0 at the foot
    of_axes = {
        id(line)
        for axis in figure.findobj(Axis)
        for line in (*axis.get_gridlines(), *axis.get_ticklines(), *axis.get_minorticklines())
    }
    for artist in artists:
        if id(artist) in of_axes or _has_edge(artist):
            continue
        parts = [_contrasts(below, colours, places) for colours, places in _marks(artist, boxes)]
        ratios = [np.median(ratio) for ratio in parts if len(ratio)]
        num_pale = sum(ratio < LEAST_CONTRAST for ratio in ratios)
        if num_pale:
            part = f" ({num_pale} of {len(ratios)} parts)" if len(ratios) > 1 else ""
            yield f"{_called(artist)} has a contrast of {min(ratios):.2f}{part}"


def _has_edge(artist: Artist) -> bool:
    """Return whether something is drawn around an artist that parts it from what lies below."""
    effects = artist.get_path_effects() or []
    edges = [effect for effect in effects if not isinstance(effect, Normal)]
    has_box = isinstance(artist, Text) and artist.get_bbox_patch() is not None
    is_edged = artist.get_gid() == EDGED
    return has_box or is_edged or any(_is_wider(effect) for effect in edges)


def _is_wider(effect: AbstractPathEffect) -> bool:
    """Return whether an effect of a path has a colour of its own."""
    return bool(getattr(effect, "colour", "") or getattr(effect, "_gc", {}).get("foreground"))


def _marks(artist: Artist, boxes: dict) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield colours ``[C, 4]``, the best of which tells an artist, and places ``[N, 2]`` in dots, of each part."""
    alpha = artist.get_alpha()
    if isinstance(artist, Text):
        if id(artist) in boxes:
            west, south, east, north = boxes[id(artist)].bounds
            x, y = np.meshgrid(np.linspace(west, east, 12), np.linspace(south, north, 6))
            places = np.column_stack([x.ravel(), y.ravel()])
            yield to_rgba_array(artist.get_color(), alpha), places
    elif isinstance(artist, Line2D):
        xy = artist.get_transform().transform(artist.get_xydata())
        xy = xy[np.isfinite(xy).all(axis=1)]
        is_line = artist.get_linestyle() not in ("None", " ", "") and len(xy) > 1
        if is_line:
            shares = np.linspace(0, 1, PLACES)
            points = shapely.line_interpolate_point(shapely.LineString(xy), shares, normalized=True)
            line_xy = shapely.get_coordinates(points)
            yield to_rgba_array(artist.get_color(), alpha), _inside(artist, line_xy)
        elif artist.get_marker() not in ("None", None, "", " "):
            colours = [artist.get_markerfacecolor(), artist.get_markeredgecolor()]
            shown = [each for each in colours if each != "none"]
            size = artist.get_markersize() * artist.get_figure(root=True).dpi / 72
            for place in _inside(artist, xy)[:PLACES]:
                yield to_rgba_array(shown, alpha), place + size * AROUND
    elif isinstance(artist, PathCollection):
        xy = artist.get_offset_transform().transform(np.ma.filled(artist.get_offsets(), np.nan))
        faces, edges = artist.get_facecolor(), artist.get_edgecolor()
        for k in np.unique(np.linspace(0, len(xy) - 1, min(len(xy), PLACES)).astype(int)):
            looks = [each[k % len(each)] for each in (faces, edges) if len(each)]
            if looks and np.isfinite(xy[k]).all():
                yield np.array(looks), _inside(artist, xy[[k]])
    elif isinstance(artist, Collection):
        colours = artist.get_color()
        for k, segment in enumerate(artist.get_segments()):
            xy = artist.get_transform().transform(segment)
            yield colours[[k % len(colours)]], _inside(artist, xy)


def _inside(artist: Artist, xy: np.ndarray) -> np.ndarray:
    """Return the places that are drawn: those in the box that clips the artist."""
    clip = artist.get_clip_box() if artist.get_clip_on() else None
    if clip is None or not len(xy):
        return xy
    box = clip.padded(CUT_PX)
    return xy[((xy >= box.min) & (xy <= box.max)).all(axis=1)]


def _contrasts(below: np.ndarray, colours: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Return ``[N]`` the contrast of the best of some colours with the pixels at places."""
    rows, cols = below.shape[:2]
    col, row = np.floor(xy).astype(int).T
    is_on = (col >= 0) & (row >= 0) & (col < cols) & (row < rows)
    ground = below[row[is_on], col[is_on]]
    opacity = colours[:, None, 3:]
    over = opacity * colours[:, None, :3] + (1 - opacity) * ground  # [C, N, 3]
    one, other = _luminance(over) + 0.05, _luminance(ground) + 0.05
    return (np.maximum(one, other) / np.minimum(one, other)).max(axis=0)


def _luminance(rgb: np.ndarray) -> np.ndarray:
    """Return the relative luminance of sRGB colours ``[..., 3]``, as WCAG 2.2 has it."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return linear @ LUMINANCE


def _called(artist: Artist) -> str:
    """Return what a sentence calls an artist."""
    if isinstance(artist, Text):
        return repr(" ".join(artist.get_text().split())[:60])
    return f"{type(artist).__name__} {artist.get_label()!r}"


def assert_legible(figure: Figure) -> list[tuple[str, Bbox]]:
    """Check that nothing is wrong with a figure (`faults`); return its texts with their boxes in dots."""
    assert faults(figure) == []
    return [(text.get_text(), Text.get_window_extent(text)) for text in drawn_texts(figure)]
