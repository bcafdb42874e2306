"""Demonstrations from files of routes and from planned paths, each on the map that its route was flown on."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.errors import InputError, LeftOutWarning, OtherSettingsWarning, typed
from jaxurban.io.read.routes import read_routes
from jaxurban.io.tables import SUFFIXES
from jaxurban.maps.metric_maps import GivenMaps, as_maps
from jaxurban.paths.constraints import KEPT_CLEAR, Constraints, constraints_said
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.rows import RouteRules
from jaxurban.paths.snapping import XY
from jaxurban.planners.base import CostKind
from jaxurban.planners.cost_model import CostModel
from jaxurban.studies.demonstrations import Demonstration, demonstration_from_line
from jaxurban.world.grid import Grid

MOST_REASONS = 3  # in an error; a warning has them all

Planned = Sequence[tuple[str, Mapping[str, Any]]]  # routes by name, with the settings they were planned under
MapOf = Callable[[float, str | None, str | None], CostMap]  # by altitude, time and time of day


@typed
def read_demonstrations(
    file: str | Path,
    maps: GivenMaps,
    altitude_m: float | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    *,
    cost_model: CostModel | CostKind | None = None,
    constraints: Constraints | None = None,
    preset: str = "",
    metrics: Sequence[str] | None = None,
) -> list[Demonstration]:
    """Return the routes of a file as demonstrations; lists of several files or cities may be joined with ``+``.

    Lines are taken as they are; ends in closed cells move to free ones by at most 50 m, and lines of no use are left
    out with a warning that says which and why. A table of queries holds no lines: `plan_many` plans it, and
    `demonstrations_from_paths` takes its paths, or this function the ``.geojson`` that they were saved to.

    Altitude and times are those given here; where left out, the feature's own properties ``altitude_m``, ``time`` and
    ``time_of_day`` (paths that jaxurban wrote carry them); without these, times are the maps' first ones.

    Args:
      file: GeoJSON, KML, GPX, or another vector file, with LineStrings, or a mission (``.plan``).
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      altitude_m, time, time_of_day: of every route.
      cost_model: of every route; left out, the one that jaxurban's own paths were planned under.
      constraints: no-fly zones, bounds and clearances, as in `plan`.
      preset: as in `plan`; of the cost model where no route names one.
      metrics: those whose weights are to be fitted; all if left out.

    Raises:
      InputError: no lines, or none with an altitude, on a map, inside the maps and past obstacles, or paths that were
        planned under different cost models.
    """
    if Path(file).suffix.lower() in SUFFIXES:
        raise InputError(
            f"{str(file)!r} is a table, which holds no lines: plan its queries first (plan_many) and save the paths as "
            ".geojson"
        )
    routes = read_routes(file)
    planned = [(f"route {route.name!r} of {str(file)!r}", route.settings) for route in routes]
    rules = RouteRules(cost_model=cost_model, constraints=constraints or Constraints(), preset=preset)
    grid, map_of = _cost_maps(maps, planned, rules, metrics)
    demonstrations, reasons = [], []
    for number, route in enumerate(routes, start=1):
        z_m = route.altitude_m if altitude_m is None else altitude_m
        place = ", ".join(f"{degrees:.6f}" for degrees in route.lonlat[0])
        label = f"line {number} ({route.name!r}, from {place})"
        try:
            if z_m is None:
                raise InputError("it has no altitude: give it a property altitude_m, or pass --altitude (altitude_m=)")
            on = map_of(float(z_m), time or route.time, time_of_day or route.time_of_day)
            xy_m = np.stack(grid.xy_of_lonlat(*route.lonlat.T), axis=-1)
            demonstrations.append(demonstration_from_line(on, xy_m, route.name, label))
        except InputError as error:
            reasons.append(f"{error}" if label in f"{error}" else f"{label}: {error}")
    some = "; ".join(reasons[:MOST_REASONS]) + ("; ..." if len(reasons) > MOST_REASONS else "")
    if not demonstrations:
        raise InputError(f"no line of {str(file)!r} is of use: {some}")
    if reasons:
        left_out = f"{len(reasons)} of {len(routes)} lines of {str(file)!r} were left out: {'; '.join(reasons)}"
        warnings.warn(left_out, LeftOutWarning, stacklevel=3)
    return demonstrations


@typed
def demonstrations_from_paths(
    paths: PlannedPath | Sequence[PlannedPath],
    maps: GivenMaps,
    *,
    cost_model: CostModel | CostKind | None = None,
    constraints: Constraints | None = None,
    preset: str = "",
    metrics: Sequence[str] | None = None,
) -> list[Demonstration]:
    """Return planned paths as demonstrations, each on the map that it was planned on.

    Args:
      paths: from `plan`, one or several.
      maps: the maps that they were planned on, or their folder.
      cost_model: left out, the one that they were planned under.
      constraints: those that they were planned under; a path does not carry its zones.
      preset: of the maps and the clearance, as in `plan`.
      metrics: as in `read_demonstrations`.

    Raises:
      InputError: a path without points, maps that are not those of the paths, or paths that were planned under
        different cost models.
    """
    paths = [paths] if isinstance(paths, PlannedPath) else list(paths)
    if not paths:
        raise InputError("there are no paths: give at least one")
    planned = [(f"path {number}", path.settings) for number, path in enumerate(paths, start=1)]
    rules = RouteRules(cost_model=cost_model, constraints=constraints or Constraints(), preset=preset)
    _, map_of = _cost_maps(maps, planned, rules, metrics)
    return [_from_path(map_of, path, f"{number}") for number, path in enumerate(paths, start=1)]


def _from_path(map_of: MapOf, planned: PlannedPath, name: str) -> Demonstration:
    label = f"demonstration {name!r}"
    if len(planned.z_m) and np.ptp(planned.z_m) > 0:
        raise InputError(f"{label} changes its altitude, and fits take one: leave it out")
    if len(planned.xy_m) == 0:
        raise InputError(f"{label} is a path without points ({planned.status.value}): leave it out")
    on = map_of(planned.altitude_m, planned.settings["time"], planned.settings["time_of_day"])
    for end, xy_m in (("start", planned.xy_m[0]), ("goal", planned.xy_m[-1])):
        cell = on.cell_of(end, XY(*xy_m.tolist()))[1]
        if not on.is_free[cell]:
            raise InputError(
                f"the {end} of {label} is {on.why_closed(cell)}: give the maps and constraints that it was planned on, "
                "or choose obstacles = centre if it was planned by centres"
            )
    return demonstration_from_line(on, planned.xy_m, name)


def _cost_maps(
    given: GivenMaps, planned: Planned, rules: RouteRules, metrics: Sequence[str] | None
) -> tuple[Grid, MapOf]:
    """Return the maps' grid, and a function of altitude, time and time of day: the cost map there, made once.

    The cost model is the one given, else the one that the routes were planned under, else the default. Warns of routes
    that were planned under another one than is given, and of the first that was planned under other constraints.

    Raises:
      InputError: settings whose cost model is none, or routes that name different ones.
    """
    maps, settled = rules.under(as_maps(given))
    models: dict[CostModel, str] = {}
    for name, settings in planned:
        if "cost_model" in settings:
            try:
                models.setdefault(CostModel.from_settings(settings), name)
            except InputError as error:
                raise InputError(f"{name}: {error}") from error
    if rules.cost_model is None and len(models) > 1:
        (one, name), (other, other_name), *_ = models.items()
        raise InputError(
            f"{name} was planned under the cost model {one} and {other_name} under {other}: fit them apart, or name "
            "one for all (--cost-model, cost_model=)"
        )
    model = next(iter(models), settled.cost_model) if rules.cost_model is None else settled.cost_model
    for other, name in models.items():
        if other != model:
            both = f"{name} was planned under the cost model {other} and is fitted under {model}, as given"
            warnings.warn(both, OtherSettingsWarning, stacklevel=4)
    settled = replace(settled, cost_model=model)
    _compare_constraints(planned, settled.constraints)

    @cache
    def made(*at: Any) -> CostMap:
        whole = settled.cost_map(maps, *at)
        return whole if metrics is None else whole.only(metrics)

    return maps.grid, made


def _compare_constraints(planned: Planned, constraints: Constraints) -> None:
    """Warn of the first route that was planned under other constraints, whatever files the zones are from."""
    now = constraints.to_dict()
    for name, settings in planned:
        before = settings.get("limits")
        if isinstance(before, Mapping) and _without_files(before) != _without_files(now):
            warnings.warn(
                f"{name} was planned under other constraints ({constraints_said(before) or 'none'}) than it is fitted "
                f"under ({constraints_said(now) or 'none'}), all the same: give those that it was planned under "
                "(--no-fly, --require, --clearance, --vertical-clearance; constraints=)",
                OtherSettingsWarning,
                stacklevel=4,
            )
            return


def _without_files(constraints: Mapping[str, Any]) -> tuple[list, list, float, float]:
    """Return zones, bounds, and what is kept from obstacles, the vehicle's radius included, and over roofs."""
    zones = [{name: value for name, value in zone.items() if name != "file"} for zone in constraints.get("no_fly", ())]
    across, radius, up = (float(constraints.get(name, 0.0)) for name in KEPT_CLEAR)
    return zones, list(constraints.get("require", ())), across + radius, up
