"""Whether two places are joined by free cells, and what would join them where they are not."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.ndimage import generate_binary_structure, label

from jaxurban.errors import InputError
from jaxurban.io.store import short_number, stored_resolutions
from jaxurban.maps.metric_maps import MetricMaps, open_maps
from jaxurban.paths.constraints import Constraints
from jaxurban.planners.base import Cell

NO_CLEARANCE = "without a clearance"
CENTRE_REMEDY = "under obstacles = centre (--obstacles centre; such a path cuts true outlines)"


@dataclass(frozen=True, eq=False)
class Reachability:
    """Which places of maps are joined by free cells, by altitude; each altitude's labels are made once.

    Attributes:
      maps: under their own rule of obstacles.
      constraints: what closes cells beside obstacles.
      time, time_of_day: of the maps that bounds are on.
      cuts_corners: whether a diagonal step needs no free neighbour (``diagonal="always"``).
    """

    maps: MetricMaps
    constraints: Constraints
    time: str | None
    time_of_day: str | None
    cuts_corners: bool
    _labels: dict[float, np.ndarray] = field(default_factory=dict, repr=False)

    def joins(self, start: Cell, goal: Cell, altitude_m: float) -> bool:
        """Return whether free cells join two cells at one altitude."""
        if altitude_m not in self._labels:
            is_free = self.constraints.is_free(self.maps, altitude_m, time=self.time, time_of_day=self.time_of_day)
            self._labels[altitude_m] = islands_of(is_free, self.cuts_corners)
        labels = self._labels[altitude_m]
        return bool(labels[start] == labels[goal] != 0)

    @cached_property
    def _by_centre(self) -> "Reachability | None":
        """Under the paper's rule of obstacles; None where these maps are under it, or a distance counts more."""
        if self.maps.obstacles == "centre" or self.constraints.horizontal_m:
            return None
        return replace(self, maps=self.maps.with_obstacles("centre"), _labels={})

    @cached_property
    def _without_clearance(self) -> "Reachability | None":
        """Under the same zones and bounds without a clearance; None where none is kept."""
        if not self.constraints.keeps_clear:
            return None
        return replace(self, constraints=self.constraints.without_clearance(), _labels={})

    @cached_property
    def _finer(self) -> "tuple[Reachability, ...]":
        """On the finer maps of the same folder, the finest last."""
        return tuple(replace(self, maps=maps, _labels={}) for maps in _finer_maps(self.maps))

    def what_would_join(self, start: Cell, goal: Cell, altitude_m: float) -> str:
        """Return a sentence on what would join two cells that nothing joins at an altitude.

        Tried are the paper's rule of obstacles, no clearance where one is kept, the finer maps of the same folder until
        one joins them, and the maps' greater altitudes.
        """
        tried = {}
        if self._by_centre is not None:
            tried[CENTRE_REMEDY] = self._by_centre.joins(start, goal, altitude_m)
        if self._without_clearance is not None:
            tried[NO_CLEARANCE] = self._without_clearance.joins(start, goal, altitude_m)
        has_finer = False
        for finer in self._finer:
            ends = (finer.maps.grid.cell_of_xy(*self.maps.grid.xy_of_cell(*cell)) for cell in (start, goal))
            first, second = ((int(row), int(col)) for row, col in ends)
            try:
                finer.maps.around(altitude_m)
                is_joined = finer.joins(first, second, altitude_m)
            except InputError:  # damaged, or of other altitudes: the result stands without them
                continue
            has_finer = True
            tried[f"in cells of {short_number(finer.maps.grid.resolution_m)} m"] = is_joined
            if is_joined:
                break
        if higher_m := sorted(z_m for z_m in self.maps.altitudes_m if z_m > altitude_m):
            lowest_m = next((z_m for z_m in higher_m if self.joins(start, goal, z_m)), None)
            tried["at a greater altitude of these maps" if lowest_m is None else f"at {lowest_m:g} m"] = bool(lowest_m)
        unknown = "" if has_finer else " Finer maps, of which there are none here, may join them too."
        return joined_sentence(tried) + unknown


def islands_of(is_free: np.ndarray, cuts_corners: bool) -> np.ndarray:
    """Return the number of the island of each free cell, ``[Y, X]`` or ``[K, Y, X]``, 0 where it is closed.

    On one level cells join as on one altitude; from level to level straight up and down, which all climbs come to.
    """
    touching = generate_binary_structure(2, 2 if cuts_corners else 1)
    if is_free.ndim == 3:
        flat, touching = touching, generate_binary_structure(3, 1)
        touching[1] = flat
    return np.asarray(label(is_free, touching)[0])


def levels_that_join(here: Reachability, start: Cell, goal: Cell, levels_m: np.ndarray) -> str:
    """Return a sentence on what would join two nodes: the paper's obstacles, no clearance, or higher levels."""
    maps = here.maps

    def joins(maps: MetricMaps, levels_m: np.ndarray, constraints: Constraints = here.constraints) -> bool:
        is_free = constraints.free_levels(maps, levels_m.tolist(), time=here.time, time_of_day=here.time_of_day)
        islands = islands_of(is_free, here.cuts_corners)
        return bool(islands[start] == islands[goal] != 0)

    tried = {}
    if here.constraints.keeps_clear:
        tried[NO_CLEARANCE] = joins(maps, levels_m, here.constraints.without_clearance())
    if maps.obstacles == "touched" and not here.constraints.horizontal_m:
        tried[CENTRE_REMEDY] = joins(maps.with_obstacles("centre"), levels_m)
    if higher_m := [z_m for z_m in sorted(maps.altitudes_m) if z_m > levels_m[-1]]:
        tops = (k for k in range(len(higher_m)) if joins(maps, np.append(levels_m, higher_m[: k + 1])))
        top = next(tops, None)
        phrase = "at any greater altitude of these maps" if top is None else f"with max_altitude_m {higher_m[top]:g}"
        tried[phrase] = top is not None
    return f"{joined_sentence(tried)} Finer maps may join them too.".strip()


def joined_sentence(tried: Mapping[str, bool]) -> str:
    """Return the sentence on what joins start and goal and what does not, from phrases and whether each does."""
    joined, apart = ([what for what, is_so in tried.items() if is_so is wanted] for wanted in (True, False))
    phrases = [f"joined {' and '.join(joined)}"] if joined else []
    phrases += [f"not joined {' nor '.join(apart)}"] if apart else []
    return f"Start and goal are {', but '.join(phrases)}." if phrases else ""


def _finer_maps(maps: MetricMaps) -> list[MetricMaps]:
    """Return the whole finer maps of the folder that maps were opened from, the finest last."""
    source = maps.ds.encoding.get("source")
    if source is None:
        return []
    folder = Path(source).parent.parent
    found = []
    for resolution_m in sorted((r for r in stored_resolutions(folder) if r < maps.grid.resolution_m), reverse=True):
        with suppress(InputError):  # damaged ones do not help
            found.append(open_maps(folder, resolution_m, obstacles=maps.obstacles))
    return found
