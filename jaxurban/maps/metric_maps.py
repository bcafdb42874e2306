"""MetricMaps: the metric maps of one region at one resolution; save and open."""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from jaxurban.checks import finite, typed
from jaxurban.errors import InputError, warn
from jaxurban.io.samples import BASE_MAP_FILE
from jaxurban.metrics.base import UNDERSIDE, Metric
from jaxurban.metrics.custom import held_metrics
from jaxurban.progress import LOG
from jaxurban.public import Caution, FactsRepr, caution_of_guesses, listed
from jaxurban.settings import Obstacles, Planning, iso_utc
from jaxurban.world.grid import Grid
from jaxurban.world.surface import stands_at

if TYPE_CHECKING:
    import geopandas as gpd

OF_ROUTES = (
    "weights",
    "planning",
    "vehicle",
)  # sections of a scenario that routes over its maps are planned under


def _placed(ds: xr.Dataset) -> xr.Dataset:
    """Return maps whose attributes say where their cells lie, also where they were cut out of larger ones.

    Raises:
      InputError: cells that are not side by side.
    """
    if not {"y", "x"} <= {*ds.coords}:  # the attributes alone say it
        return ds
    side_m, first = float(ds.attrs["resolution_m"]), {}
    for axis, name in (("y", "first_row"), ("x", "first_col")):
        at_m = ds[axis].values
        number = at_m / side_m - 0.5
        first[name] = int(np.round(number[0]))
        if np.abs(number - first[name] - np.arange(len(at_m))).max() > 0.01:
            raise InputError(
                f"the maps' {axis} must run cell by cell in steps of {side_m:g} m: cut maps by slices without a step"
            )
    return (
        ds
        if all(ds.attrs[name] == value for name, value in first.items())
        else ds.assign_attrs(first)
    )


@typed
@dataclass(frozen=True, repr=False)
class MetricMaps(FactsRepr):
    """The metric maps of one region at one resolution, as an xarray Dataset.

    Variables (values are m; rows run south to north): ``obstacle`` and ``lidar`` and ``risk``
    [altitude, y, x]; ``gps``, ``gdop``, ``pdop``, ``hdop``, ``vdop``, ``tdop`` and ``num_visible``
    [time, altitude, y, x]; ``population`` and ``density`` (people per km2) [time_of_day, y, x], only
    with population data; ``roof`` (at the cell's centre), ``roof_touched`` (the highest that shares area with the
    cell) and ``terrain`` (only if not flat) [y, x] in metres; ``has_data`` [y, x]. Roofs count what hangs; of a city
    with slabs ``underside`` is the lowest floor over the cell's centre, 0 where nothing hangs.
    DOPs are inf without a position fix. **Missing is NaN**: everything where ``has_data`` is False, and inside
    obstacles (``obstacle`` is 1) what is undefined there: m of gps, lidar, risk and protection with their bounds,
    spreads and statistics, DOPs and levels, so that means over cells are `numpy.nanmean`; ``num_visible`` is 0 there.
    Of a long series of times, instead of ``gps`` and the DOPs: ``gps_availability``, ``gps_median`` and ``gps_p05``
    [altitude, y, x], ``gps_epoch_mean`` [time, altitude] (mean m over free cells) and ``gps_worst_time`` [altitude].
    On request ``protection``, ``hpl`` and ``vpl`` (metres, inf where undetermined) and ``within_limits``
    [time, altitude, y, x], or the same statistics of ``protection``.
    Maps that were opened from a folder are read when they are looked at.

    Attributes:
      ds: the dataset; ``ds.attrs`` hold CRS, resolution, provenance and `recorded`.
      rule: where every planner may fly (`obstacles`); None: as the scenario or a preset has it.
      base: the source of the buildings, or a file in the maps' folder, that `base_map` is read from if it has one.

    Raises:
      InputError: an unknown rule of obstacles, or a part of maps that leaves cells out.

    Examples:
      >>> maps.altitudes_m, maps.times, list(maps.metrics)
      ((20.0, 60.0), ('2020-04-27T16:00:00Z',), ['gps', 'lidar', 'population', 'risk'])
      >>> maps.ds["gps"].dims, maps.ds["gps"].shape
      (('time', 'altitude', 'y', 'x'), (1, 2, 30, 30))
    """

    ds: xr.Dataset
    rule: Obstacles | None = None
    base: str | Path | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "ds", _placed(self.ds))

    @property
    def folder(self) -> Path | None:
        """The folder that they were opened from; None for maps in memory."""
        from jaxurban.io.store import OPENED

        opened = self.ds.encoding.get(OPENED)
        return None if opened is None else opened.path.parents[1]

    @property
    def recorded(self) -> dict[str, Any]:
        """The ``[weights]``, ``[planning]`` and ``[vehicle]`` of the scenario; empty for maps without one.

        Of ``[planning]`` what was given. Whatever plans on these maps takes from here what its caller leaves out.
        """
        return json.loads(self.ds.attrs.get("settings", "{}"))

    @property
    def planning(self) -> Planning:
        """How paths over them are sought, as their scenario says it."""
        return Planning(**self.recorded.get("planning", {}))

    def with_recorded(self, settings: Mapping[str, Any]) -> "MetricMaps":
        """Return the same maps with other settings of a run on record (`recorded`).

        Returns:
          The maps; of the settings they keep ``weights``, ``planning`` and ``vehicle``.

        Examples:
          >>> maps.with_recorded({"weights": {"risk": 5.0}}).recorded
          {'weights': {'risk': 5.0}}
        """
        kept = {name: settings[name] for name in OF_ROUTES if name in settings}
        return replace(self, ds=self.ds.assign_attrs(settings=json.dumps(kept)))

    @property
    def obstacles(self) -> Obstacles:
        """Where every planner may fly.

        ``"touched"``: in cells that share no area with a roof that reaches the altitude. ``"centre"``: in cells whose
        centre no such roof covers, the paper's rule, which is that of ``obstacle`` and of every metric; paths then cut
        true outlines.
        """
        return self.rule or self.planning.rules.obstacles

    @property
    def facts(self) -> dict[str, str]:
        """Grid, CRS, altitudes, times and metrics held, and the credit."""
        grid = self.grid
        return {
            "grid": f"{grid.num_rows:,} x {grid.num_cols:,} cells of {grid.resolution_m:g} m",
            "CRS": grid.crs,
            "altitudes": f"{listed([f'{z_m:g}' for z_m in self.altitudes_m])} m",
            "times": listed(self.times),
            "times of day": listed(self.times_of_day),
            "metrics": ", ".join(self.metrics),
            "obstacles": self.obstacles,
            "credit": self.attribution,
        }

    @property
    def known_cautions(self) -> list[Caution]:
        """That they rest on `guesses`."""
        return caution_of_guesses(self.guesses)

    @property
    def attribution(self) -> str:
        """Whom to credit for the data that the maps are made of, empty where nobody asks for it."""
        return self.ds.attrs.get("attribution", "")

    @cached_property
    def base_map(self) -> "gpd.GeoDataFrame | None":
        """Streets, water, parks and names below the maps, to orient in; nothing is computed from it.

        From the OpenStreetMap file or the sample city that the maps were made of, or from their folder; None without
        one, or where it cannot be read (the log says so). Features in EPSG:4326, cut at the region: ``kind`` (``water``
        and ``park``, polygons; ``path``, ``street``, ``major`` and ``rail``, lines; ``place``, points) and ``name``,
        empty without one. ``attrs`` hold ``credit`` and ``licence``. Read when it is first looked at.
        """
        from jaxurban.io.read.base_map import (
            base_map_source,
            read_base_map,
        )  # imported here: it brings the readers

        try:
            if (source := base_map_source(self.base)) is None:
                return None
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", UserWarning
                )  # of a coast with a gap: a picture's ground, no more
                frame = read_base_map(source, self.grid.crs, self.grid.bounds_m)
        except Exception as error:  # whatever a damaged file raises: maps are whole without it
            LOG.warning(f"no streets and names below the maps: {error}")
            return None
        return None if frame.empty else frame

    @property
    def identity(self) -> dict[str, str]:
        """Run, grid and rule of obstacles, which no other maps share: for the record of what was made on them."""
        names = ("run_key", "crs", "resolution_m", "first_row", "first_col")
        return {name: str(self.ds.attrs.get(name)) for name in names} | {
            "obstacles": self.obstacles
        }

    @property
    def guesses(self) -> dict[str, str]:
        """What the maps rest on that no file says, a sentence each by its short name (`jaxurban.io.read.guesses`)."""
        return json.loads(self.ds.attrs.get("guesses", "{}"))

    @property
    def grid(self) -> Grid:
        """The grid of every map."""
        attrs, sizes = self.ds.attrs, self.ds.sizes
        first_row, first_col = int(attrs["first_row"]), int(attrs["first_col"])
        return Grid(
            attrs["crs"], float(attrs["resolution_m"]), first_row, first_col, sizes["y"], sizes["x"]
        )

    @property
    def altitudes_m(self) -> tuple[float, ...]:
        """Altitudes above ground of the maps."""
        return tuple(float(value) for value in self.ds["altitude"].values)

    @property
    def times(self) -> tuple[str, ...]:
        """UTC times of the GPS maps, ISO 8601."""
        return tuple(
            f"{value}Z" for value in np.datetime_as_string(self.ds["time"].values, unit="s")
        )

    @property
    def default_time(self) -> str | None:
        """The first time; None where a long series keeps statistics over time instead of every time's maps."""
        return None if "gps_median" in self.ds else self.times[0]

    @property
    def times_of_day(self) -> tuple[str, ...]:
        """Times of day of the population maps, empty without population."""
        return (
            tuple(str(value) for value in self.ds["time_of_day"].values)
            if "population" in self.ds
            else ()
        )

    @property
    def metrics(self) -> Mapping[str, Metric]:
        """The metrics of the cost in these maps by name, those that a user added too, in the order of the layers."""
        return held_metrics(self.ds)

    def _pick(self, name: str, value: Any, held: Sequence) -> int:
        if value is not None and value not in held:
            shown = ", ".join(map(str, held)) or "none, so leave it out"
            raise InputError(f"there are no maps for {name} {value}: these maps hold {shown}")
        return 0 if value is None else held.index(value)

    @typed
    def check_altitude(self, altitude_m: float) -> None:
        """Raise InputError unless these maps hold an altitude.

        Examples:
          >>> maps.check_altitude(60.0)
          >>> try:
          ...     maps.check_altitude(40.0)
          ... except ju.InputError as error:
          ...     print(error)
          there are no maps for altitude 40.0: these maps hold 20.0, 60.0
        """
        self._pick("altitude", altitude_m, self.altitudes_m)

    @typed
    def around(self, altitude_m: float) -> list[float]:
        """Return an altitude if these maps hold it, else the two that they hold next below and above it.

        Returns:
          The altitudes, ascending, metres above ground.

        Raises:
          InputError: it is no number, or lies outside the range of these maps.

        Examples:
          >>> maps.around(60.0), maps.around(40.0)
          ([60.0], [20.0, 60.0])
        """
        altitude_m = finite("altitude_m", altitude_m)
        low_m, high_m = min(self.altitudes_m), max(self.altitudes_m)
        if not low_m <= altitude_m <= high_m:
            raise InputError(
                f"there are no maps for altitude {altitude_m:g} m: these maps reach from {low_m:g} to {high_m:g} m"
            )
        low_m = max(z_m for z_m in self.altitudes_m if z_m <= altitude_m)
        return sorted({low_m, min(z_m for z_m in self.altitudes_m if z_m >= altitude_m)})

    @typed
    def m(
        self,
        name: str,
        altitude_m: float | None = None,
        *,
        time: str | None = None,
        time_of_day: str | None = None,
    ) -> np.ndarray:
        """Return one map ``[y, x]``, rows south to north.

        Args:
          name: a variable, such as ``"gps"`` or ``"hdop"``; ``"gps"`` of a long series is its median.
          altitude_m: one of `altitudes_m`; the first listed if left out.
          time: one of `times`; the first if left out.
          time_of_day: one of `times_of_day`; the first if left out.

        Returns:
          The map, in the unit of the variable; m is 0 to 1. Missing values are NaN.

        Raises:
          InputError: no such variable, altitude, time or time of day in these maps.

        Examples:
          >>> gps = maps.m("gps", 60.0)
          >>> gps.shape, round(float(np.nanmean(gps)), 2)
          ((30, 30), 0.88)
          >>> round(float(np.nanmax(maps.m("roof"))))  # metres
          395
        """
        held = self.variable(name)
        if held != name and time is not None:
            raise InputError(
                f"these maps hold {self.metrics[name].label.split()[0]} statistics over {len(self.times)} epochs and "
                f'no map of {time}: leave time out (m is then the median), or make them with [gps] series = "epochs"'
            )
        name = held
        if name not in self.ds:
            raise InputError(
                f"these maps hold no {name!r}: they hold {', '.join(map(str, self.ds.data_vars))}"
            )
        wanted = {
            "altitude": self._pick("altitude", altitude_m, self.altitudes_m),
            "time": self._pick("time", None if time is None else iso_utc(time), self.times),
            "time_of_day": self._pick("time of day", time_of_day, self.times_of_day),
        }
        maps = self.ds[
            name
        ].variable  # without its coordinates, which nobody asks for and xarray would cut too
        return maps.isel({dim: index for dim, index in wanted.items() if dim in maps.dims}).values

    def variable(self, name: str) -> str:
        """Return which variable holds a metric: its median where a long series keeps statistics, else its own.

        Returns:
          The name of the variable in ``ds``.

        Examples:
          >>> maps.variable("gps")  # of a long series: 'gps_median'
          'gps'
        """
        return f"{name}_median" if name not in self.ds and f"{name}_median" in self.ds else name

    @typed
    def is_free(self, altitude_m: float, obstacles: Obstacles | None = None) -> np.ndarray:
        """Return ``[y, x]`` bool: no obstacle at an altitude, data there, and a value of every layer that a user added.

        At one of the maps' altitudes a cell that ``obstacle`` blocks is never free, whatever the roofs say. Metrics are
        defined under what hangs, but nobody may fly there: heights of floors are not known well enough.

        Args:
          altitude_m: above ground; one of the maps' altitudes, or any other.
          obstacles: left out, the maps' own rule: where planners may fly. ``"centre"``: where metrics are defined.

        Returns:
          True where a path may fly; False inside obstacles and where a height is not known.

        Raises:
          InputError: maps that hold no touched roofs, an unknown rule, or an altitude that is no number.

        Examples:
          >>> is_free = maps.is_free(20.0)
          >>> is_free.shape, round(float(is_free.mean()), 2)
          ((30, 30), 0.84)
          >>> round(float(maps.is_free(20.0, "centre").mean()), 2)
          0.94
        """
        altitude_m = finite("altitude_m", altitude_m)
        rule = obstacles or self.obstacles
        is_free = self.ds["has_data"].values
        is_held = altitude_m in self.altitudes_m
        if is_held:
            is_free = is_free & (self.m("obstacle", altitude_m) == 0)
        if rule == "touched" or not is_held or (obstacles is None and UNDERSIDE in self.ds):
            if rule == "touched" and "roof_touched" not in self.ds:
                raise InputError(
                    "these maps hold no 'roof_touched', the roofs that planners keep clear of: make them again, or "
                    'plan with obstacles = "centre" (--obstacles centre), under which paths cut true outlines'
                )
            roof_m = self.m(
                "roof" if rule == "centre" else "roof_touched"
            )  # NaN, an unknown height, is never free
            is_free = (
                is_free & ~stands_at(roof_m, roof_m.dtype.type(altitude_m)) & ~np.isnan(roof_m)
            )
        for name in self.metrics:
            if "layer" in self.ds[self.variable(name)].attrs:
                for z_m in self.around(
                    float(np.clip(altitude_m, min(self.altitudes_m), max(self.altitudes_m)))
                ):
                    is_free = is_free & ~np.isnan(self.m(name, z_m))
        return is_free

    def is_under_sky(self, altitude_m: float) -> np.ndarray:
        """Return ``[y, x]`` bool: `is_free` by centres, with nothing that hangs over the centre above the altitude.

        Returns:
          True where metrics are defined and nothing hangs above.

        Examples:
          >>> round(float(maps.is_under_sky(20.0).mean()), 2)
          0.94
        """
        return self.with_obstacles("centre").is_free(altitude_m)

    @typed
    def with_obstacles(self, obstacles: Obstacles) -> "MetricMaps":
        """Return the same maps with another rule of where planners may fly (see ``obstacles``).

        Returns:
          The maps, which share their dataset with these.

        Examples:
          >>> maps.obstacles, maps.with_obstacles("centre").obstacles
          ('touched', 'centre')
        """
        return replace(self, rule=obstacles)

    @typed
    def costs(
        self, altitude_m: float, *, time: str | None = None, time_of_day: str | None = None
    ) -> dict:
        """Return the cost layers c in [0, 1] by metric, ``[y, x]`` each; NaN where m is missing.

        Returns:
          The layers: ``{"gps": array, ...}`` in the order of `metrics`.

        Examples:
          >>> costs = maps.costs(60.0, time_of_day="night")
          >>> list(costs), costs["risk"].shape
          (['gps', 'lidar', 'population', 'risk'], (30, 30))
        """
        return {
            name: metric.cost(self.m(name, altitude_m, time=time, time_of_day=time_of_day))
            for name, metric in self.metrics.items()
        }

    @typed
    def total(
        self, altitude_m: float, *, time: str | None = None, time_of_day: str | None = None
    ) -> np.ndarray:
        """Return H_total, the unweighted sum of the cost layers, ``[y, x]``; NaN where one of them is missing.

        Returns:
          The sum, from 0 to the number of layers.

        Examples:
          >>> total = maps.total(20.0)
          >>> total.shape, round(float(np.nanmean(total)), 2)
          ((30, 30), 0.75)
        """
        return np.sum(
            [*self.costs(altitude_m, time=time, time_of_day=time_of_day).values()], axis=0
        )

    @typed
    def normalised(
        self, altitude_m: float, *, time: str | None = None, time_of_day: str | None = None
    ) -> np.ndarray:
        """Return H_norm, H_total brought to [0, 1] over free cells, NaN elsewhere, ``[y, x]``.

        Returns:
          The map, 0 at the cheapest free cell and 1 at the costliest; 0 everywhere where all cost the same.

        Examples:
          >>> norm = maps.normalised(60.0)
          >>> float(np.nanmin(norm)), float(np.nanmax(norm))
          (0.0, 1.0)
        """
        total = self.total(altitude_m, time=time, time_of_day=time_of_day)
        is_free = self.is_free(altitude_m, "centre")
        low, high = (
            edge(total[is_free], initial=end) for edge, end in ((np.min, np.inf), (np.max, -np.inf))
        )
        return np.where(
            is_free, (total - low) / (high - low if high > low else 1), np.float32(np.nan)
        )

    @typed
    def prefers_gps(self, altitude_m: float, *, time: str | None = None) -> np.ndarray:
        """Return the sensor-choice map ``[y, x]`` bool: m_gps > m_lidar; False inside obstacles.

        Returns:
          True where GPS serves better than lidar.

        Examples:
          >>> round(float(maps.prefers_gps(20.0).mean()), 2), round(float(maps.prefers_gps(60.0).mean()), 2)
          (0.87, 0.99)
        """
        return self.m("gps", altitude_m, time=time) > self.m("lidar", altitude_m)

    @typed
    def save(self, folder: str | Path, *, layers: Sequence[str] = ()) -> Path:
        """Write Zarr, cloud-optimised GeoTIFFs and their QGIS styles under ``folder``; return it.

        The record of ``jaxurban maps`` stays beside maps of its own run alone: it holds their weights and settings.

        Args:
          folder: where to; the reference's page on files says what lies there.
          layers: variables that are GeoTIFFs too, such as ``("hdop", "roof")``, beside obstacles and the metrics of
            the cost; ``("all",)``: every one.

        Returns:
          The folder, which `open_maps` opens.

        Raises:
          InputError: a layer that these maps do not hold, a folder that cannot be written to, a file in the way that
            was not written so or was changed since, or variables that nobody could read back: without obstacles, or a
            name that is a path.

        Examples:
          >>> folder = maps.save("out", layers=["hdop"])
          >>> sorted(file.name for file in folder.iterdir())
          ['checksums.json', 'geotiff', 'maps.zarr']
        """
        from jaxurban.io.files import sweep_scraps
        from jaxurban.io.geotiff import RUN_KEY, geotiff_paths, write_geotiffs
        from jaxurban.io.read.base_map import save_base_map
        from jaxurban.io.store import (
            GEOTIFF_FOLDER,
            OPENED,
            RUN_FILE,
            are_of_a_run,
            open_zarr,
            root_files,
            write_zarr,
        )
        from jaxurban.io.workspace import Workspace
        from jaxurban.metrics.variables import NEEDED

        if lost := [name for name in NEEDED if name not in self.ds]:
            raise InputError(
                f"these maps lack {', '.join(lost)}, without which nothing can open them: put it back"
            )
        if paths := [name for name in map(str, self.ds.variables) if "/" in name]:
            raise InputError(
                f"a variable called {paths[0]!r} cannot be written: give it a name without /"
            )
        folder = Path(folder)
        geotiffs = geotiff_paths(self.ds, folder, layers)  # refuses what is not there
        with Workspace.open(folder, "maps", is_shared=True, is_mended=True) as workspace:
            workspace.check_way(geotiffs)
            base_files = [folder / BASE_MAP_FILE] if self.base_map is not None else []
            workspace.check_way([*base_files, *root_files(folder)], is_mended=True)
            ds = self.ds.copy()
            key, of_folder = ds.attrs.get(RUN_KEY), workspace.settings.get(RUN_KEY)
            is_of_run = key is not None and key == of_folder and (folder / RUN_FILE).is_file()
            # A run's own folder has the settings in its record, and another's has no use for the key.
            ds.attrs.pop("settings" if is_of_run else RUN_KEY, None)
            if not is_of_run:
                workspace.settings.clear()
            write_zarr(ds, folder)
            if (
                OPENED in self.ds.encoding
            ):  # from this folder, it may be: then its files are no longer there
                ds = open_zarr(folder.resolve(), self.grid.resolution_m)
            write_geotiffs(ds, folder, layers=layers)
            save_base_map(self.base_map, workspace)
            sweep_scraps(folder / GEOTIFF_FOLDER)  # of GDAL, from a run that was killed
            if not are_of_a_run(folder):
                workspace.remove([RUN_FILE])
        return folder


MapsLike = MetricMaps | str | Path  # what `as_maps` takes


@typed
def open_maps(
    folder: str | Path, resolution_m: float | None = None, *, obstacles: Obstacles | None = None
) -> MetricMaps:
    """Return the maps that ``MetricMaps.save`` or ``jaxurban maps`` wrote under ``folder``.

    Every file is looked for; those of the maps are read, and compared with their checksums, when values are.
    A GeoTIFF that ``jaxurban maps`` wrote and that is missing is a warning, as nothing here reads it.

    Args:
      folder: the output folder.
      resolution_m: which of them; may be left out when there is one.
      obstacles: where planners may fly (see `MetricMaps`); left out, as the scenario has it.

    Returns:
      The maps; each is read when it is first looked at.

    Raises:
      InputError: no maps there, or several and none chosen, or an unknown rule of obstacles; damaged ones (later too,
        when values are read), or a run's without its settings (``run.json``).

    Examples:
      >>> folder = maps.save("out")
      >>> again = ju.open_maps(folder)
      >>> bool(np.array_equal(again.m("risk", 60.0), maps.m("risk", 60.0), equal_nan=True))
      True
    """
    from jaxurban.io.geotiff import missing_geotiffs
    from jaxurban.io.store import open_zarr, settings_of

    ds = open_zarr(Path(folder), resolution_m)
    if "run_key" in ds.attrs and (lost := missing_geotiffs(ds, Path(folder))):
        others = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
        warn(
            f"{str(lost[0])!r}{others} is missing or empty: the same `jaxurban maps` command writes it again",
        )
    base = Path(folder).resolve() / BASE_MAP_FILE
    maps = MetricMaps(ds, obstacles, base if base.is_file() else None)
    return maps.with_recorded(settings) if (settings := settings_of(Path(folder))) else maps


def as_maps(given: MapsLike) -> MetricMaps:
    """Return maps as they are, or those of the folder that is given, which holds them at one resolution.

    Raises:
      InputError: neither of these, or a folder that `open_maps` cannot open.
    """
    if isinstance(given, MetricMaps):
        return given
    if not isinstance(given, str | Path):
        raise InputError(
            f"maps must be MetricMaps or the folder that holds them, got {type(given).__name__}"
        )
    return open_maps(given)
