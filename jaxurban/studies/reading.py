"""Examples from files of routes and from planned paths, each on the map that its route was flown on."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.errors import InputError, OtherSettingsWarning
from jaxurban.io.routes import read_routes
from jaxurban.limits import Limits, limits_said
from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.planners.base import CostKind, CostModel
from jaxurban.studies.examples import Example, example_from_line, example_from_path
from jaxurban.studies.queries import unit_map
from jaxurban.weighted import WeightedMap


class UnitMaps:
    """The unit maps of one set of maps, made when first asked for. ``Setting``: altitude, time, time of day."""

    def __init__(self, maps: MetricMaps, **settings: Any) -> None:
        """Keep the settings that all of them share (see `queries.unit_map`)."""
        self._maps, self._settings = maps, settings
        self._made: dict[tuple[float, str | None, str | None], WeightedMap] = {}

    def __call__(self, altitude_m: float, time: str | None, time_of_day: str | None) -> WeightedMap:
        """Return the map of one altitude and time."""
        key = (float(altitude_m), time, time_of_day)
        if key not in self._made:
            self._made[key] = unit_map(self._maps, altitude_m, time=time, time_of_day=time_of_day, **self._settings)
        return self._made[key]


def read_examples(
    file: str | Path,
    maps: MetricMaps,
    altitude_m: float | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    *,
    cost_model: CostModel | CostKind | None = None,
    default_cost_model: CostModel | CostKind = "cell",
    limits: Limits | None = None,
    metrics: Sequence[str] | None = None,
) -> list[Example]:
    """Return the lines of a file as examples; lists of several files or cities may be joined with ``+``.

    Altitude and times are those given here; where left out, the feature's own properties ``altitude_m``, ``time`` and
    ``time_of_day`` (paths that jaxurban wrote carry them); without these, times are the maps' first ones.

    Args:
      file: GeoJSON, or another vector file that GDAL reads, with LineStrings.
      maps: from `build_maps` or `open_maps`.
      altitude_m, time, time_of_day: of every route.
      cost_model: of every route; left out, the one that jaxurban's own paths were planned under.
      default_cost_model: where no route tells one.
      limits: no-fly zones and bounds, as in `plan`.
      metrics: those whose weights are to be fitted; all if left out.

    Raises:
      InputError: no lines, or a route without altitude, on no map, outside the maps or through obstacles, or paths
        that were planned under different cost models.
    """
    routes = read_routes(file)
    limits = limits or Limits()
    told = [(f"route {route.name!r} of {str(file)!r}", route.settings) for route in routes]
    model = _model_of(told, cost_model, default_cost_model)
    _compare_limits(told, limits)
    units = UnitMaps(maps, cost_model=model, limits=limits, metrics=metrics)
    examples = []
    for route in routes:
        z_m = route.altitude_m if altitude_m is None else altitude_m
        if z_m is None:
            raise InputError(
                f"route {route.name!r} of {str(file)!r} has no altitude: give it a property altitude_m, or pass "
                "--altitude (altitude_m=)"
            )
        try:
            unit = units(z_m, time or route.time, time_of_day or route.time_of_day)
            x_m, y_m = maps.grid.xy_of_lonlat(route.lonlat[:, 0], route.lonlat[:, 1])
        except InputError as error:
            raise InputError(f"route {route.name!r} of {str(file)!r}: {error}") from error
        examples.append(example_from_line(unit, np.stack([x_m, y_m], axis=-1), route.name))
    return examples


def examples_from_paths(
    paths: Sequence[PlannedPath],
    maps: MetricMaps,
    *,
    cost_model: CostModel | CostKind | None = None,
    limits: Limits | None = None,
    metrics: Sequence[str] | None = None,
) -> list[Example]:
    """Return planned paths as examples, each on the map that it was planned on.

    Args:
      paths: from `plan`.
      maps: the maps that they were planned on.
      cost_model: left out, the one that they were planned under.
      limits: those that they were planned under; a path does not carry its zones.
      metrics: as in `read_examples`.

    Raises:
      InputError: a path without points, maps that are not those of the paths, or paths that were planned under
        different cost models.
    """
    if not paths:
        raise InputError("there are no paths: give at least one")
    limits = limits or Limits()
    told = [(f"path {number}", path.settings) for number, path in enumerate(paths, start=1)]
    _compare_limits(told, limits)
    units = UnitMaps(maps, cost_model=_model_of(told, cost_model, "cell"), limits=limits, metrics=metrics)
    return [
        example_from_path(
            units(path.altitude_m, path.settings["time"], path.settings["time_of_day"]), path, f"{number}"
        )
        for number, path in enumerate(paths, start=1)
    ]


Told = Sequence[tuple[str, Mapping[str, Any]]]  # routes by name, with the settings that they were planned under


def _model_of(told: Told, asked: CostModel | CostKind | None, default: CostModel | CostKind) -> CostModel:
    """Return the cost model of routes: the one asked for, else the one that they were planned under, else a default.

    Warns of routes that were planned under another one than is asked for.

    Raises:
      InputError: settings that name no cost model, or routes that name different ones.
    """
    models: dict[CostModel, str] = {}
    for name, settings in told:
        if "cost_model" in settings:
            try:
                models.setdefault(CostModel.from_settings(settings), name)
            except InputError as error:
                raise InputError(f"{name}: {error}") from error
    if asked is not None:
        model = CostModel.of(asked)
        for other, name in models.items():
            if other != model:
                said = f"{name} was planned under the cost model {other} and is fitted under {model}, as is asked"
                warnings.warn(said, OtherSettingsWarning, stacklevel=3)
        return model
    if len(models) > 1:
        (one, name), (other, other_name), *_ = models.items()
        raise InputError(
            f"{name} was planned under the cost model {one} and {other_name} under {other}: fit them apart, or name "
            "one for all (--cost-model, cost_model=)"
        )
    return next(iter(models), CostModel.of(default))


def _compare_limits(told: Told, limits: Limits) -> None:
    """Warn of the first route that was planned under other limits than these, whatever files the zones are from."""
    now = limits.to_dict()
    for name, settings in told:
        before = settings.get("limits")
        if isinstance(before, Mapping) and _without_files(before) != _without_files(now):
            files = sorted({str(zone.get("file")) for zone in before.get("no_fly", ())})
            options = [f"--no-fly {file}" for file in files]
            options += [f"--require '{bound}'" for bound in before.get("require", ())]
            remedy = f"give {' '.join(options)} (limits=)" if options else "leave --no-fly and --require (limits=) out"
            warnings.warn(
                f"{name} was planned under other limits ({limits_said(before) or 'none'}) than it is fitted under "
                f"({limits or 'none'}): {remedy}, so that it is compared with routes of the same limits",
                OtherSettingsWarning,
                stacklevel=3,
            )
            return


def _without_files(told: Mapping[str, Any]) -> tuple[list, list]:
    zones = [{name: value for name, value in zone.items() if name != "file"} for zone in told.get("no_fly", ())]
    return zones, list(told.get("require", ()))
