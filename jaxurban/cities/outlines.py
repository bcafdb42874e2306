"""Features as a file holds them, near a region: their outlines, and under which names their tags are known."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from pyproj.exceptions import ProjError

from jaxurban.errors import InputError
from jaxurban.io.city import joined_credits
from jaxurban.io.issues import ReadIssues
from jaxurban.world.grid import Bounds, known_crs, transformer

MARGIN_M = 1000.0  # more than projections tilt boxes against each other, and than most outlines and their parts reach


@dataclass(frozen=True)
class Outlines:
    """Building outlines as a file holds them. ``N`` outlines.

    Attributes:
      polygons: ``[N]`` shapely Polygons or MultiPolygons in ``crs``, valid or not; None where none could be built.
      tags: ``[N]`` arrays of numbers, or of objects (text, numbers or None), by name: ``building``, ``part``,
        ``height``, ``levels``, ``roof_levels``, ``min_height``, ``min_level``, ``location``, ``layer``,
        ``man_made``. All are optional; without ``building`` every outline is a building.
      crs: CRS of the coordinates, x before y.
      boxes: x_min, y_min, x_max, y_max in ``crs`` each, that the file says it covers.
      issues: what the reader met.
      attribution: the credit that the data's licence asks for.
      is_part: whether these are the outlines near a region only.
    """

    polygons: np.ndarray
    tags: Mapping[str, np.ndarray]
    crs: str
    boxes: tuple[Bounds, ...]
    issues: ReadIssues
    attribution: str = ""
    is_part: bool = False

    def take(self, index: np.ndarray) -> "Outlines":
        """Return the outlines at ``index`` (integers or a mask)."""
        tags = {name: column[index] for name, column in self.tags.items()}
        return replace(self, polygons=self.polygons[index], tags=tags)

    def column(self, name: str) -> np.ndarray:
        """Return a tag of every outline, ``[N]`` objects, None where it is missing."""
        return self.tags.get(name, np.full(len(self.polygons), None, object))

    def texts(self, name: str) -> np.ndarray:
        """Return a tag of every outline as text in small letters, ``[N]`` objects, empty where it is missing."""
        number, different = self.words(name)
        return different[number]

    def says(self, name: str, texts: Iterable[str]) -> np.ndarray:
        """Return ``[N]`` whether a tag of outlines is one of some texts in small letters, of which none is empty."""
        number, different = self.words(name)
        wanted = {*texts}
        return np.array([text in wanted for text in different], bool)[number]

    def words(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the different texts of a tag, some perhaps equal in small letters, and ``[N]`` which each has."""
        name = name if name in self.tags else ""  # one for all that are missing
        if name not in self._words:
            column = self.column(name)
            texts = np.full(len(column), "", object)
            is_filled = ~pd.isna(column)
            texts[is_filled] = [*map(str, column[is_filled])]
            number, different = pd.factorize(texts)
            small = [text.strip().lower() for text in different]
            self._words[name] = number, np.array(small, object)
        return self._words[name]

    @cached_property
    def _words(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """The words that were asked for, by name."""
        return {}


def joined_outlines(path: Path, several: Sequence[Outlines]) -> Outlines:
    """Return the outlines of several files as of one.

    Args:
      path: the folder or the archive that holds them, for messages.
      several: one at least.

    Raises:
      InputError: they are in several CRSs.
    """
    first = several[0]
    crs = known_crs(first.crs)
    if not all(crs.equals(known_crs(each.crs), ignore_axis_order=True) for each in several):
        raise InputError(
            f"{str(path)!r} holds files in several CRSs: convert them to one, as with `ogr2ogr -t_srs EPSG:... OUT IN`"
        )
    if len(several) == 1:
        return first
    names = {name: None for each in several for name in each.tags}
    issues: Counter = Counter()
    for each in several:
        issues.update(each.issues)
    return Outlines(
        np.concatenate([each.polygons for each in several]),
        {
            name: np.concatenate([each.column(name).astype(object) for each in several])
            for name in names
        },
        first.crs,
        tuple(box for each in several for box in each.boxes),
        dict(issues),
        joined_credits(*(each.attribution for each in several)),
        any(each.is_part for each in several),
    )


class Near(NamedTuple):
    """A region whose surroundings are read.

    Attributes:
      bounds_m: x_min, y_min, x_max, y_max; what does not touch them is not needed.
      crs: their projected CRS.
    """

    bounds_m: Bounds
    crs: str

    def box_in(self, crs: str) -> Bounds | None:
        """Return the box of the region and `MARGIN_M` around it in another CRS.

        None where no box holds it: beyond a projection's reach, or across the antimeridian.
        """
        x_min, y_min, x_max, y_max = self.bounds_m
        wide_m = x_min - MARGIN_M, y_min - MARGIN_M, x_max + MARGIN_M, y_max + MARGIN_M
        if not np.isfinite(wide_m).all():
            return None
        try:
            box = transformer(self.crs, crs).transform_bounds(*wide_m, densify_pts=101)
        except ProjError:
            return None
        is_box = np.isfinite(box).all() and box[0] < box[2]  # not across the antimeridian
        return box if is_box else None
