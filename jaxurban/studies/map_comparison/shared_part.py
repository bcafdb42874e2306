"""The part that two sets of maps share: cells, altitudes, times and layers, with the reason for what they do not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyproj
import xarray as xr

from jaxurban.errors import InputError
from jaxurban.io.read.orbits import iso_utc, parse_time
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.studies.queries import NORMS
from jaxurban.world.grid import Grid
from jaxurban.world.show import listed


@dataclass(frozen=True, eq=False)
class SharedPart:
    """Two sets of maps cut to what both hold, so that cell (y, x), altitude and time mean the same in both.

    Attributes:
      a, b: the maps; those of ``b`` carry the names of ``a``'s times.
      times: A's time and the one of B beside it.
      left_out: what only one of them holds, with the reason.
      cut: ``[2]`` how many of the cells of A and of B were cut off.
    """

    a: MetricMaps
    b: MetricMaps
    times: Mapping[str, str]
    left_out: Mapping[str, str] = field(default_factory=dict)
    cut: tuple[int, int] = (0, 0)


def shared_part(a: MetricMaps, b: MetricMaps, times: Mapping[str, str] | None = None) -> SharedPart:
    """Return what two sets of maps share.

    Args:
      a, b: the maps.
      times: B's time by A's, for maps of different times; left out, the times that both hold, and where each holds a
        single one, these two.

    Raises:
      InputError: another CRS or resolution, no cell, altitude or layer that both hold, or times that do not pair.
    """
    grid = _shared_grid(a.grid, b.grid)
    altitudes_m = _both("altitude", a.altitudes_m, b.altitudes_m)
    days = [item for item in a.times_of_day if item in b.times_of_day]
    names, left_out = _shared_layers(a, b)
    left_out |= {
        f"altitude {z_m:g} m": f"only {which} holds it"
        for which, maps in (("A", a), ("B", b))
        for z_m in maps.altitudes_m
        if z_m not in altitudes_m
    }
    if not days:
        for name in [name for name in names if TIME_OF_DAY in a.ds[name].dims]:
            names.remove(name)
            left_out[name] = (
                f"A's times of day ({', '.join(a.times_of_day) or 'none'}) are none of B's "
                f"({', '.join(b.times_of_day) or 'none'})"
            )
    paired = _paired(a, b, times) if any(TIME in a.ds[name].dims for name in names) else {}
    parts = [
        _cut(maps, grid, names, altitudes_m, days, list(when))
        for maps, when in ((a, paired.keys()), (b, paired.values()))
    ]
    if paired:
        parts[1] = MetricMaps(parts[1].ds.assign_coords(time=parts[0].ds["time"]), b.obstacles)
    num_cells = grid.num_rows * grid.num_cols
    cut = tuple(int(np.prod(maps.grid.shape)) - num_cells for maps in (a, b))
    return SharedPart(parts[0], parts[1], paired, left_out, (cut[0], cut[1]))


def _shared_grid(a: Grid, b: Grid) -> Grid:
    """Return the cells that two grids share; cells of one CRS and one resolution coincide wherever they meet."""
    if pyproj.CRS(a.crs) != pyproj.CRS(b.crs):
        raise InputError(
            f"A's maps are in {a.crs} and B's in {b.crs}, so that no cell is in both: make one of them again with "
            f"[region] crs = {a.crs!r}"
        )
    if a.resolution_m != b.resolution_m:
        raise InputError(
            f"A's cells are {a.resolution_m:g} m wide and B's {b.resolution_m:g} m: make one of them again with "
            "[region] resolution_m set to the other's (a list makes both), or choose with --resolution"
        )
    first = max(a.first_row, b.first_row), max(a.first_col, b.first_col)
    end = (
        min(a.first_row + a.num_rows, b.first_row + b.num_rows),
        min(a.first_col + a.num_cols, b.first_col + b.num_cols),
    )
    if end[0] <= first[0] or end[1] <= first[1]:
        raise InputError(
            f"the maps share no cell: A spans {_extent(a)} and B {_extent(b)} in {a.crs}; compare maps of regions that "
            "overlap"
        )
    return Grid(a.crs, a.resolution_m, *first, end[0] - first[0], end[1] - first[1])


def _extent(grid: Grid) -> str:
    return f"{grid.x_min_m:.0f} to {grid.x_max_m:.0f} m east and {grid.y_min_m:.0f} to {grid.y_max_m:.0f} m north"


def _both(what: str, a: Sequence[float], b: Sequence[float]) -> list[float]:
    shared = [value for value in a if value in b]
    if not shared:
        had = (listed([f"{value:g}" for value in values]) for values in (a, b))
        raise InputError(
            f"the maps share no {what}: A holds {next(had)} m and B {next(had)} m; add one of A's to B's scenario"
        )
    return shared


def _shared_layers(a: MetricMaps, b: MetricMaps) -> tuple[list[str], dict[str, str]]:
    """Return the maps that both hold along the same dims, and what only one holds."""
    shared, left_out = [], {}
    for name in dict.fromkeys((*map(str, a.ds.data_vars), *map(str, b.ds.data_vars))):
        held = [maps.ds[name].dims if name in maps.ds else None for maps in (a, b)]
        if any(dims is not None and not {"y", "x"} <= set(dims) for dims in held):
            continue  # a number a time, no map
        if held[0] == held[1]:
            shared.append(name)
        elif None in held:
            left_out[name] = f"only {'A' if held[1] is None else 'B'} holds it"
        else:
            left_out[name] = "it varies along other dimensions in B"
    return shared, left_out


def _paired(a: MetricMaps, b: MetricMaps, times: Mapping[str, str] | None) -> dict[str, str]:
    if times is not None:
        pairs = {iso_utc(parse_time(of_a)): iso_utc(parse_time(of_b)) for of_a, of_b in times.items()}
        for which, maps, wanted in (("A", a, pairs), ("B", b, pairs.values())):
            if lost := [time for time in wanted if time not in maps.times]:
                raise InputError(f"{which} holds no maps of {lost[0]}: it holds {listed(maps.times)}")
        if not pairs:
            raise InputError("times is empty: name at least one pair of times, or leave it out")
        return pairs
    shared = {time: time for time in a.times if time in b.times}
    if shared:
        return shared
    if len(a.times) == len(b.times) == 1:
        return {a.times[0]: b.times[0]}
    raise InputError(
        f"the maps share no time: A holds {listed(a.times)} and B {listed(b.times)}; name the pairs to compare, as in "
        f"--time {a.times[0]}={b.times[0]} (times={{...}})"
    )


def _cut(
    maps: MetricMaps,
    grid: Grid,
    names: Sequence[str],
    altitudes_m: Sequence[float],
    times_of_day: Sequence[str],
    times: Sequence[str],
) -> MetricMaps:
    rows, cols = grid.window_in(replace(maps.grid, crs=grid.crs))
    ds: xr.Dataset = maps.ds[list(names)].isel(y=rows, x=cols)
    attrs = dict(ds.attrs, crs=grid.crs)
    if TIME not in ds.coords:  # of maps without GPS; `MetricMaps` has times all the same
        ds = ds.assign_coords({TIME: maps.ds[TIME]})
    if ALTITUDE in ds.dims:
        ds = ds.isel({ALTITUDE: [maps.altitudes_m.index(z_m) for z_m in altitudes_m]})
    if times and TIME in ds.dims:
        ds = ds.isel({TIME: [maps.times.index(time) for time in times]})
    if TIME_OF_DAY in ds.dims:
        chosen = [maps.times_of_day.index(item) for item in times_of_day]
        ds = ds.isel({TIME_OF_DAY: chosen})
        for norm in [name for name in NORMS if name in attrs]:
            attrs[norm] = np.atleast_1d(attrs[norm])[chosen].tolist()
    return MetricMaps(ds.assign_attrs(attrs), maps.obstacles)
