"""Wires: lines cut at their vertices, each piece a curtain from the ground up to the higher of its two supports."""

from dataclasses import replace

import numpy as np
import shapely

from jaxurban.cities.kinds import LONG_SPAN_M
from jaxurban.cities.outlines import Outlines
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.kinds import WIRES

SUPPORT_M = 1.0  # so near a vertex a point carries the wire


def in_spans(outlines: Outlines) -> Outlines:
    """Return outlines, ``N``, with every line of a wire as its spans, one for each pair of vertices.

    Args:
      outlines: from `what_stands`.
    """
    # Buildings have no name of a kind.
    names = [getattr(verdict, "name", "") for verdict in outlines.tags["verdict"]]
    dimension = shapely.get_dimensions(outlines.polygons)
    is_wire = np.isin(names, WIRES) & (dimension > 0)
    wires = np.flatnonzero(is_wire)
    is_area = dimension[wires] == 2
    shapes = outlines.polygons[wires]
    drawn = np.where(is_area, shapely.boundary(shapes), shapes)
    lines, wire_of_line = shapely.get_parts(drawn, return_index=True)
    vertices, line_of_vertex = shapely.get_coordinates(lines, return_index=True)
    first = np.flatnonzero(line_of_vertex[:-1] == line_of_vertex[1:])
    spans = shapely.linestrings(np.stack([vertices[first], vertices[first + 1]], axis=1))
    wire_of_span = wire_of_line[line_of_vertex[first]]

    others = np.flatnonzero(~is_wire)
    cut = outlines.take(np.append(others, wires[wire_of_span]))
    return replace(cut, polygons=np.append(outlines.polygons[others], spans))


def with_supports(structures: Footprints, shapes: np.ndarray) -> Footprints:
    """Return structures in which spans without a height of their own have that of the higher of their two supports.

    A vertex without a support counts as high as its line by kind. Sag is left out: a wire hangs lower. A span of more
    than `LONG_SPAN_M` between guessed heights has no bound.

    Args:
      structures: ``N``, with spans of `in_spans`.
      shapes: ``[N]`` what they were before they had an extent.
    """
    dimension = shapely.get_dimensions(shapes)
    is_span = (dimension == 1) & np.isin(structures.kinds, WIRES) & structures.is_guessed
    is_support = (dimension == 0) & (structures.height_m > 0)
    supports = structures.take(is_support)
    ends = shapely.points(shapely.get_coordinates(shapes[is_span]))
    end, support = shapely.STRtree(shapes[is_support]).query_nearest(ends, max_distance=SUPPORT_M)

    def at_higher_end(name: str) -> np.ndarray:
        """Return of each span a column of the higher of its supports, or its own; it is unsure if either end is."""
        by_end = np.repeat(getattr(structures, name)[is_span], 2)
        by_end[end] = getattr(supports, name)[support]
        return by_end.reshape(-1, 2).max(axis=1)

    is_unsure = at_higher_end("is_guessed")
    is_long = shapely.length(shapes[is_span]) > LONG_SPAN_M
    assert structures.limit_m is not None
    height_m, limit_m = structures.height_m.copy(), structures.limit_m.copy()
    origin = structures.origin.copy()
    height_m[is_span] = at_higher_end("height_m")
    limit_m[is_span] = np.where(is_unsure & is_long, np.inf, at_higher_end("upper_m"))
    origin[is_span] = np.where(is_unsure, HeightOrigin.DEFAULT, HeightOrigin.HEIGHT)
    return replace(structures, height_m=height_m, limit_m=limit_m, origin=origin)
