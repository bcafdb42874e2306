"""Whether two places are joined by free cells, and what would join them where they are not."""

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import generate_binary_structure, label

from jaxurban.planners.base import Cell

if TYPE_CHECKING:
    from jaxurban.paths.cost_map import CostMap


def islands_of(is_free: np.ndarray, cuts_corners: bool) -> np.ndarray:
    """Return the number of the island of each free cell, ``[Y, X]`` or ``[K, Y, X]``, 0 where it is closed.

    On one level cells join as on one altitude; from level to level straight up and down, which all climbs come to.
    """
    touching = generate_binary_structure(2, 2 if cuts_corners else 1)
    if is_free.ndim == 3:
        flat, touching = touching, generate_binary_structure(3, 1)
        touching[1] = flat
    return np.asarray(label(is_free, touching)[0])


def islands_at(on: "CostMap", levels_m: tuple[float, ...], keeps_clear: bool) -> np.ndarray:
    """Return `islands_of` the free cells of other levels under a cost map's constraints, or without its clearances."""
    limits = on.constraints if keeps_clear else on.constraints.without_clearance()
    is_free = limits.free_levels(on.maps, [*levels_m], time=on.time, time_of_day=on.time_of_day)
    cuts_corners = on.cost_model.joins_corners and not limits.leg_margin_m(on.grid.resolution_m)
    return islands_of(is_free[0] if on.levels is None else is_free, cuts_corners)


def what_would_join(on: "CostMap", start: Cell, goal: Cell) -> str:
    """Return sentences on what would join two nodes that nothing joins: no clearance, or a greater altitude."""
    levels_m = tuple(on.altitudes_m.tolist())
    higher_m = [z_m for z_m in sorted(on.maps.altitudes_m) if z_m > levels_m[-1]]
    if on.levels is None:
        tops = {f"at {z_m:g} m": (z_m,) for z_m in higher_m}
    else:
        tops = {f"with max_altitude_m {z_m:g}": (*levels_m, *higher_m[: k + 1]) for k, z_m in enumerate(higher_m)}

    def joins(levels_m: tuple[float, ...], keeps_clear: bool = True) -> bool:
        islands = on.islands_at(levels_m, keeps_clear)
        return bool(islands[start] == islands[goal] != 0)

    tried = {"without a clearance": joins(levels_m, False)} if on.constraints.keeps_clear else {}
    if tops:
        lowest = next((phrase for phrase, top in tops.items() if joins(top)), "")
        tried[lowest or "at a greater altitude of these maps"] = bool(lowest)
    joined, apart = ([what for what, is_so in tried.items() if is_so is wanted] for wanted in (True, False))
    phrases = [f"joined {' and '.join(joined)}"] if joined else []
    phrases += [f"not joined {' nor '.join(apart)}"] if apart else []
    centre = " or obstacles = centre (--obstacles centre)" * (on.maps.obstacles == "touched")
    return f"Start and goal are {', but '.join(phrases)}. " * bool(phrases) + f"Finer maps{centre} may join them too."
