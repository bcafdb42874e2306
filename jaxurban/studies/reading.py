"""Examples from files of routes and from planned paths, each on the map that its route was flown on."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.routes import read_routes
from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.planners.base import CostModel
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
    **settings: Any,
) -> list[Example]:
    """Return the lines of a file as examples; lists of several files or cities may be joined with ``+``.

    Altitude and times are those given here; where left out, the feature's own properties ``altitude_m``, ``time`` and
    ``time_of_day`` (paths that jaxurban wrote carry them); without these, times are the maps' first ones.

    Args:
      file: GeoJSON, or another vector file that GDAL reads, with LineStrings.
      maps: from `build_maps` or `open_maps`.
      altitude_m, time, time_of_day: of every route.
      settings: ``metrics`` (those whose weights are to be fitted; all if left out), ``cost_model`` (default
        ``"cell"``), as in `queries.unit_map`.

    Raises:
      InputError: no lines, or a route without altitude, on no map, outside the maps or through obstacles.
    """
    units = UnitMaps(maps, **settings)
    examples = []
    for route in read_routes(file):
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


def examples_from_paths(paths: Sequence[PlannedPath], maps: MetricMaps, **settings: Any) -> list[Example]:
    """Return planned paths as examples, each on the map that it was planned on.

    Args:
      paths: from `plan`.
      maps: the maps that they were planned on.
      settings: as in `read_examples`; by default those of the first path.

    Raises:
      InputError: a path without points, or maps that are not those of the paths.
    """
    if not paths:
        raise InputError("there are no paths: give at least one")
    units = UnitMaps(maps, **{"cost_model": CostModel.from_settings(paths[0].settings)} | settings)
    return [
        example_from_path(
            units(path.altitude_m, path.settings["time"], path.settings["time_of_day"]), path, f"{number}"
        )
        for number, path in enumerate(paths, start=1)
    ]
