"""Demonstrations from files of routes and from planned paths, each on the map that its route was flown on."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, LeftOutWarning, OtherSettingsWarning, typed
from jaxurban.io.read.routes import read_routes
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.metrics.weights import Weights
from jaxurban.paths.constraints import KEPT_CLEAR, Constraints, constraints_said
from jaxurban.paths.cost_map import CostMap, cost_map
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.preset import under_preset
from jaxurban.planners.base import CostKind
from jaxurban.planners.cost_model import CostModel
from jaxurban.studies.demonstrations import Demonstration, demonstration_from_line, demonstration_from_path
from jaxurban.studies.drawn_demonstrations import MapOf, draw, holds_queries, read_drawn

ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
MOST_REASONS = 3  # in an error; a warning has them all

Planned = Sequence[tuple[str, Mapping[str, Any]]]  # routes by name, with the settings they were planned under


@typed
def read_demonstrations(
    file: str | Path | pd.DataFrame,
    maps: GivenMaps,
    altitude_m: float | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    *,
    cost_model: CostModel | CostKind | None = None,
    default_cost_model: CostModel | CostKind | None = None,
    constraints: Constraints | None = None,
    preset: str = "",
    metrics: Sequence[str] | None = None,
    planner: str | None = None,
    pilot: Weights | None = None,
) -> list[Demonstration]:
    """Return the routes of a file as demonstrations; lists of several files or cities may be joined with ``+``.

    Lines are taken as they are; ends in closed cells move to free ones by at most 50 m, and lines of no use are left
    out with a warning that says which and why. A table of queries (of `sample_instances`, or what `plan_many` saved)
    and the folder of a Monte Carlo benchmark hold no lines: their routes are found anew, each under its row's own
    weights.

    Altitude and times are those given here; where left out, the feature's own properties ``altitude_m``, ``time`` and
    ``time_of_day`` (paths that jaxurban wrote carry them); without these, times are the maps' first ones.

    Args:
      file: GeoJSON, KML, GPX, or another vector file, with LineStrings; a mission (``.plan``); a table of
        queries (``.csv``, ``.parquet``), or such a table itself; or the folder of `study`.
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      altitude_m, time, time_of_day: of every route.
      cost_model: of every route; left out, the one that jaxurban's own paths were planned under.
      default_cost_model: where no route names one.
      constraints: no-fly zones, bounds and clearances, as in `plan`.
      preset: as in `plan`; of the cost model where no route names one.
      metrics: those whose weights are to be fitted; all if left out.
      planner: of a benchmark, the one whose paths are taken; left out, ``astar-plus``, or else its first.
      pilot: weights under which the routes of a table or a benchmark are the cheapest, instead of the rows' own.

    Raises:
      InputError: no lines, or none with an altitude, on a map, inside the maps and past obstacles, or paths that were
        planned under different cost models.
    """
    maps, default, constraints = under_preset(preset, as_maps(maps), default_cost_model, constraints)
    cost_model = None if cost_model is None else under_preset(preset, maps, cost_model, None)[1]
    file = file if isinstance(file, pd.DataFrame) else Path(file)
    if isinstance(file, pd.DataFrame) or holds_queries(file):
        drawn = read_drawn(file, planner)
        taken = drawn.queries if altitude_m is None else drawn.queries.assign(altitude_m=altitude_m)
        times = {"time": time, "time_of_day": time_of_day}
        taken = taken.assign(**{name: value for name, value in times.items() if value is not None})
        settings = [(repr(drawn.name), drawn.settings)]
        model = _model_of(settings, cost_model, default)
        map_of = _cost_maps(maps, settings, model, constraints, None)
        return _on_metrics(draw(drawn._replace(queries=taken), maps, map_of, pilot), metrics)
    routes = read_routes(file)
    planned = [(f"route {route.name!r} of {str(file)!r}", route.settings) for route in routes]
    model = _model_of(planned, cost_model, default)
    map_of = _cost_maps(maps, planned, model, constraints, metrics)
    demonstrations, reasons = [], []
    for number, route in enumerate(routes):
        z_m = route.altitude_m if altitude_m is None else altitude_m
        place = ", ".join(f"{degrees:.6f}" for degrees in route.lonlat[0])
        line = f"the {ORDINALS[number]} line" if number < len(ORDINALS) else f"line {number + 1}"
        label = f"{line} ({route.name!r}, from {place})"
        try:
            if z_m is None:
                raise InputError(
                    f"{label} has no altitude: give it a property altitude_m, or pass --altitude (altitude_m=)"
                )
            on = map_of(float(z_m), time or route.time, time_of_day or route.time_of_day)
            x_m, y_m = maps.grid.xy_of_lonlat(route.lonlat[:, 0], route.lonlat[:, 1])
            xy_m = np.stack([x_m, y_m], axis=-1)
            demonstrations.append(demonstration_from_line(on, xy_m, route.name, label))
        except InputError as error:
            reasons.append(f"{error}" if label in f"{error}" else f"{label}: {error}")
    some = "; ".join(reasons[:MOST_REASONS]) + ("; ..." if len(reasons) > MOST_REASONS else "")
    if not demonstrations:
        raise InputError(
            some if len(routes) == 1 else f"none of the {len(routes)} lines of {str(file)!r} is of use: {some}"
        )
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
    if isinstance(paths, PlannedPath):
        paths = [paths]
    paths = list(paths)
    if not paths:
        raise InputError("there are no paths: give at least one")
    planned = [(f"path {number}", path.settings) for number, path in enumerate(paths, start=1)]
    maps, default, constraints = under_preset(preset, as_maps(maps), None, constraints)
    model = _model_of(planned, cost_model, default)
    map_of = _cost_maps(maps, planned, model, constraints, metrics)
    return [
        demonstration_from_path(
            map_of(path.altitude_m, path.settings["time"], path.settings["time_of_day"]), path, f"{number}"
        )
        for number, path in enumerate(paths, start=1)
    ]


def _on_metrics(demonstrations: list[Demonstration], metrics: Sequence[str] | None) -> list[Demonstration]:
    """Return demonstrations on maps of these metrics alone; their routes stay."""
    if metrics is None:
        return demonstrations

    @cache
    def only(whole: CostMap) -> CostMap:
        return whole.only(metrics)

    return [replace(each, query=replace(each.query, cost_map=only(each.query.cost_map))) for each in demonstrations]


def _cost_maps(
    maps: MetricMaps, planned: Planned, model: CostModel, constraints: Constraints, metrics: Sequence[str] | None
) -> MapOf:
    """Return a function of altitude, time and time of day: the cost map there, each made when first needed.

    Warns of the first route that was planned under other constraints.
    """
    _compare_constraints(planned, constraints)

    @cache
    def made(altitude_m: float, time: str | None, time_of_day: str | None) -> CostMap:
        whole = cost_map(
            maps, altitude_m, time=time, time_of_day=time_of_day, cost_model=model, constraints=constraints
        )
        return whole if metrics is None else whole.only(metrics)

    return made


def _model_of(planned: Planned, given: CostModel | CostKind | None, default: CostModel) -> CostModel:
    """Return the cost model of routes: the one given, else the one that they were planned under, else a default.

    Warns of routes that were planned under another one than is given.

    Raises:
      InputError: settings whose cost model is none, or routes that name different ones.
    """
    models: dict[CostModel, str] = {}
    for name, settings in planned:
        if "cost_model" in settings:
            try:
                models.setdefault(CostModel.from_settings(settings), name)
            except InputError as error:
                raise InputError(f"{name}: {error}") from error
    if given is not None:
        model = CostModel.of(given)
        for other, name in models.items():
            if other != model:
                said = f"{name} was planned under the cost model {other} and is fitted under {model}, as given"
                warnings.warn(said, OtherSettingsWarning, stacklevel=3)
        return model
    if len(models) > 1:
        (one, name), (other, other_name), *_ = models.items()
        raise InputError(
            f"{name} was planned under the cost model {one} and {other_name} under {other}: fit them apart, or name "
            "one for all (--cost-model, cost_model=)"
        )
    return next(iter(models), default)


def _compare_constraints(planned: Planned, constraints: Constraints) -> None:
    """Warn of the first route that was planned under other constraints, whatever files the zones are from."""
    now = constraints.to_dict()
    for name, settings in planned:
        before = settings.get("limits")
        if isinstance(before, Mapping) and _without_files(before) != _without_files(now):
            files = sorted({str(zone.get("file")) for zone in before.get("no_fly", ())})
            options = [f"--no-fly {file}" for file in files]
            options += [f"--require '{bound}'" for bound in before.get("require", ())]
            kept = zip(("--clearance", "--vertical-clearance"), _clearances_m(before), _clearances_m(now), strict=True)
            options += [f"{option} {metres:g}" for option, metres, other_m in kept if metres or other_m]
            remedy = (
                f"give {' '.join(options)} (constraints=)"
                if options
                else "leave --no-fly, --require and clearances (constraints=) out"
            )
            warnings.warn(
                f"{name} was planned under other constraints ({constraints_said(before) or 'none'}) than it is "
                f"fitted under ({constraints_said(now) or 'none'}): {remedy}, so that it is compared with routes under "
                "the same ones (now it is fitted all the same)",
                OtherSettingsWarning,
                stacklevel=4,
            )
            return


def _clearances_m(constraints: Mapping[str, Any]) -> tuple[float, float]:
    """Return what is kept from obstacles, the vehicle's radius included, and over roofs."""
    across, radius, up = (float(constraints.get(name, 0.0)) for name in KEPT_CLEAR)
    return across + radius, up


def _without_files(constraints: Mapping[str, Any]) -> tuple[list, list, tuple[float, float]]:
    zones = [{name: value for name, value in zone.items() if name != "file"} for zone in constraints.get("no_fly", ())]
    return zones, list(constraints.get("require", ())), _clearances_m(constraints)
