"""MetricMaps: the metric maps of one region at one resolution."""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import xarray as xr

from jaxurban import wings
from jaxurban.checks import finite, nearest_name, typed
from jaxurban.errors import InputError
from jaxurban.knowledge import Caution, Guesses, caution_of_guesses, guesses_from
from jaxurban.maps.levels import around, index_of
from jaxurban.metrics.base import TIME_OF_DAY, UNDERSIDE, Metric
from jaxurban.metrics.custom import held_metrics
from jaxurban.metrics.variables import stored_name
from jaxurban.pictures import MapForm
from jaxurban.progress import LOG
from jaxurban.public import FactsRepr, listed
from jaxurban.settings import ObstacleRule, Planning, iso_utc
from jaxurban.world.grid import Grid, crs_said, grid_of
from jaxurban.world.surface import stands_at

if TYPE_CHECKING:
    import geopandas as gpd
    from matplotlib.figure import Figure
else:
    Figure = Any  # `typed` looks hints up, and Matplotlib takes long to import

OF_ROUTES = ("weights", "planning", "vehicle")  # sections of a scenario that its routes follow


def _placed(ds: xr.Dataset) -> xr.Dataset:
    """Return maps whose attributes ``first_row`` and ``first_col`` are those of their own southwest cell (see `Grid`).

    Maps that were cut out of larger ones have the attributes of these, so the coordinates y and x decide; maps without
    these coordinates are returned unchanged.

    Raises:
      InputError: cells that are not side by side, in ascending order.
    """
    if not {"y", "x"} <= {*ds.coords}:
        return ds
    side_m = float(ds.attrs["resolution_m"])
    first = {}
    for name, axis in (("first_row", "y"), ("first_col", "x")):
        numbers = ds[axis].values / side_m - 0.5  # coordinates are those of the cells' centres
        first[name] = int(np.round(numbers[0]))
        off = np.abs(numbers - first[name] - np.arange(len(numbers)))
        if off.max() > 0.01:  # of a cell, for rounding
            raise InputError(
                f"the maps' {axis} must run cell by cell in steps of {side_m:g} m: cut maps by slices without a step"
            )
    if all(ds.attrs[name] == number for name, number in first.items()):
        return ds
    return ds.assign_attrs(first)


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
    [altitude, y, x].
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
      >>> maps["gps"].dims, maps["gps"].shape  # of maps.ds, the dataset
      (('time', 'altitude', 'y', 'x'), (1, 2, 30, 30))
    """

    ds: xr.Dataset
    rule: ObstacleRule | None = None
    base: str | Path | None = None

    def __post_init__(self) -> None:
        """Let the attributes name the southwest cell of these maps; errors as of `_placed`."""
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
        """Return the same maps with other settings of a run in `recorded`.

        Returns:
          The maps, which share their arrays with these and keep ``weights``, ``planning`` and ``vehicle`` alone of the
          settings.

        Examples:
          >>> maps.with_recorded({"weights": {"risk": 5.0}}).recorded
          {'weights': {'risk': 5.0}}
        """
        kept = {name: settings[name] for name in OF_ROUTES if name in settings}
        return replace(self, ds=self.ds.assign_attrs(settings=json.dumps(kept)))

    @property
    def obstacles(self) -> ObstacleRule:
        """Where every planner may fly.

        ``"touched"``: in cells that share no area with a roof that reaches the altitude. ``"centre"``: in cells whose
        centre no such roof covers, the paper's rule, which is that of ``obstacle`` and of every metric; paths then cut
        true outlines.
        """
        return self.rule or self.planning.rules.obstacles

    @property
    def facts(self) -> dict[str, str]:
        """What the maps are, a text each by its name: grid, CRS, altitudes, times, metrics, rule and credit."""
        grid = self.grid
        return {
            "grid": f"{grid.num_rows:,} x {grid.num_cols:,} cells of {grid.resolution_m:g} m",
            "CRS": crs_said(grid.crs),
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
        """Streets, water, parks and names below the maps, for orientation; nothing is computed from them.

        They are from the OpenStreetMap file or the sample city that the maps were made of, or from the maps' folder;
        None without such a source, or where it cannot be read (the log says so). The features are in EPSG:4326, cut at
        the region, with ``kind`` (``water`` and ``park``, polygons; ``path``, ``street``, ``major`` and ``rail``,
        lines; ``place``, points) and ``name``, empty without one. ``attrs`` hold ``credit`` and ``licence``. They are
        read when they are first looked at.
        """
        try:
            source = wings.base_map_source(self.base)
            if source is None:
                return None
            # A coast with a gap matters little to the ground of a picture.
            with warnings.catch_warnings(action="ignore", category=UserWarning):
                frame = wings.read_base_map(source, self.grid.crs, self.grid.bounds_m)
        except Exception as error:  # whatever a damaged file raises: maps are whole without it
            LOG.warning(f"no streets and names below the maps: {error}")
            return None
        return None if frame.empty else frame

    @property
    def identity(self) -> dict[str, str]:
        """What no other maps share, for the record of what is made on them: run, grid and rule of obstacles.

        Texts by name: ``run_key``, ``crs``, ``resolution_m``, ``first_row``, ``first_col`` and ``obstacles``;
        ``"None"`` where the maps do not have one, as maps of no run have no key.
        """
        names = ("run_key", "crs", "resolution_m", "first_row", "first_col")
        values = {name: str(self.ds.attrs.get(name)) for name in names}
        return {**values, "obstacles": self.obstacles}

    @property
    def guesses(self) -> Guesses:
        """What the maps rest on that no file says: records, each with a short name and a sentence."""
        return guesses_from(self.ds.attrs.get("guesses", "[]"))

    @property
    def grid(self) -> Grid:
        """The grid of every map."""
        return grid_of(self.ds)

    @property
    def altitudes_m(self) -> tuple[float, ...]:
        """Altitudes above ground of the maps."""
        return tuple(float(value) for value in self.ds["altitude"].values)

    @property
    def times(self) -> tuple[str, ...]:
        """UTC times of the GPS maps, ISO 8601."""
        texts = np.datetime_as_string(self.ds["time"].values, unit="s")
        return tuple(f"{text}Z" for text in texts)

    @property
    def default_time(self) -> str | None:
        """The first time; None where a long series keeps statistics over time instead of every time's maps."""
        return None if "gps_median" in self.ds else self.times[0]

    @property
    def times_of_day(self) -> tuple[str, ...]:
        """Times of day of the population maps, empty without population."""
        if not any(TIME_OF_DAY in metric.dims for metric in self.metrics.values()):
            return ()
        return tuple(map(str, self.ds[TIME_OF_DAY].values))

    @property
    def metrics(self) -> Mapping[str, Metric]:
        """The metrics of the cost in these maps by name, those that a user added too, in the order of the layers."""
        return held_metrics(self.ds)

    @property
    def _items(self) -> list[str]:
        return [*self.metrics, *map(str, self.ds.data_vars)]

    __iter__ = None  # `maps["gps"]` is one map, and no sequence of them

    @typed
    def __getitem__(self, name: str) -> xr.DataArray:
        """Return a variable at all altitudes and times with its coordinates; `m` returns one map, as an array.

        Raises:
          InputError: no such variable in these maps.
        """
        variable = self.variable(name)
        if variable not in self.ds:
            names = [*map(str, self.ds.data_vars)]
            hint = nearest_name(name, names)
            raise InputError(f"these maps hold no {name!r}{hint}: they hold {', '.join(names)}")
        return self.ds[variable]

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
          ((30, 30), 0.86)
          >>> round(float(np.nanmax(maps.m("roof"))))  # metres
          390
        """
        variable = self.variable(name)
        if variable != name and time is not None:
            what = held_metrics(self.ds, costs_only=False)[name].label.split()[0]
            kept = variable.rpartition("_")[2]
            raise InputError(
                f"these maps hold {what} statistics over {len(self.times)} epochs and no map of {time}: leave time out "
                f'(it is then the {kept}), or make them with [gps] series = "epochs"'
            )
        values = self[name].variable  # without coordinates, which xarray would cut too
        utc_time = None if time is None else iso_utc(time)
        index = {
            "altitude": index_of("altitude", altitude_m, self.altitudes_m),
            "time": index_of("time", utc_time, self.times),
            "time_of_day": index_of("time of day", time_of_day, self.times_of_day),
        }
        return values.isel(index, missing_dims="ignore").values

    def variable(self, name: str) -> str:
        """Return which variable holds a metric: where a long series keeps statistics its median, else its own.

        Of the GPS floor a long series keeps the highest over the times.

        Returns:
          The name of the variable in ``ds``.

        Examples:
          >>> maps.variable("gps")  # of a long series: 'gps_median'
          'gps'
        """
        return stored_name(name, self.ds)

    @typed
    def is_free(self, altitude_m: float, obstacles: ObstacleRule | None = None) -> np.ndarray:
        """Return ``[y, x]`` bool: cells without an obstacle, with data, and with a value of every layer of a user.

        At one of the maps' altitudes a cell that ``obstacle`` blocks is never free, whatever the roofs say. Metrics are
        defined under what hangs, but nobody may fly there: heights of floors are not known well enough.

        Args:
          altitude_m: above ground; one of the maps' altitudes, or any other.
          obstacles: left out, the maps' own rule: where planners may fly. ``"centre"``: where metrics are defined.

        Returns:
          True where a path may fly; False inside obstacles and where a height is not known.

        Raises:
          InputError: an unknown rule, or an altitude that is no number.

        Examples:
          >>> is_free = maps.is_free(20.0)
          >>> is_free.shape, round(float(is_free.mean()), 2)
          ((30, 30), 0.89)
          >>> round(float(maps.is_free(20.0, "centre").mean()), 2)
          0.96
        """
        altitude_m = finite("altitude_m", altitude_m)
        rule = obstacles or self.obstacles
        is_free = self.ds["has_data"].values
        has_maps = altitude_m in self.altitudes_m
        if has_maps:
            is_free = is_free & (self.m("obstacle", altitude_m) == 0)
        avoids_slabs = obstacles is None and UNDERSIDE in self.ds
        if rule == "touched" or avoids_slabs or not has_maps:
            roof_m = self.m("roof_touched" if rule == "touched" else "roof")
            is_above = ~stands_at(roof_m, roof_m.dtype.type(altitude_m)) & ~np.isnan(roof_m)
            is_free = is_free & is_above

        # Layers of a user close the cells where they have no value, on the maps next below and above the altitude.
        nearest_m = float(np.clip(altitude_m, min(self.altitudes_m), max(self.altitudes_m)))
        for name in self.metrics:
            if "layer" not in self.ds[self.variable(name)].attrs:
                continue
            for z_m in around(nearest_m, self.altitudes_m):
                is_free = is_free & ~np.isnan(self.m(name, z_m))
        return is_free

    def is_under_sky(self, altitude_m: float) -> np.ndarray:
        """Return ``[y, x]`` bool: `is_free` by centres, with nothing that hangs over the centre above the altitude.

        Returns:
          True where metrics are defined and nothing hangs above.

        Examples:
          >>> round(float(maps.is_under_sky(20.0).mean()), 2)
          0.96
        """
        return self.with_obstacles("centre").is_free(altitude_m)

    @typed
    def with_obstacles(self, obstacles: ObstacleRule) -> "MetricMaps":
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

        Args:
          altitude_m, time, time_of_day: as for `m`.

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

        Args:
          altitude_m, time, time_of_day: as for `m`.

        Returns:
          The sum, from 0 to the number of layers.

        Examples:
          >>> total = maps.total(20.0)
          >>> total.shape, round(float(np.nanmean(total)), 2)
          ((30, 30), 1.07)
        """
        costs = self.costs(altitude_m, time=time, time_of_day=time_of_day)
        return np.sum([*costs.values()], axis=0)

    @typed
    def normalised(
        self, altitude_m: float, *, time: str | None = None, time_of_day: str | None = None
    ) -> np.ndarray:
        """Return H_norm, ``[y, x]``: H_total (`total`) scaled to [0, 1] over the free cells, NaN elsewhere.

        Args:
          altitude_m, time, time_of_day: as for `m`.

        Returns:
          The map, 0 at the cheapest free cell and 1 at the costliest; 0 everywhere where all cost the same.

        Examples:
          >>> norm = maps.normalised(60.0)
          >>> float(np.nanmin(norm)), float(np.nanmax(norm))
          (0.0, 1.0)
        """
        total = self.total(altitude_m, time=time, time_of_day=time_of_day)
        return scaled_over(self.is_free(altitude_m, "centre"), total)

    @typed
    def prefers_gps(self, altitude_m: float, *, time: str | None = None) -> np.ndarray:
        """Return the sensor-choice map ``[y, x]`` bool: m_gps > m_lidar; False inside obstacles.

        Args:
          altitude_m, time: as for `m`.

        Returns:
          True where GPS serves better than lidar.

        Examples:
          >>> round(float(maps.prefers_gps(20.0).mean()), 2), round(float(maps.prefers_gps(60.0).mean()), 2)
          (0.89, 0.98)
        """
        return self.m("gps", altitude_m, time=time) > self.m("lidar", altitude_m)

    @typed
    def plot(
        self,
        name: str | None = None,
        altitude_m: float | Sequence[float] | None = None,
        *,
        time: str | None = None,
        time_of_day: str | None = None,
        paths: Any = (),  # `plot_metric` has its type: maps know no planner
        **form: Unpack[MapForm],
    ) -> Figure:
        """Return a picture of one map, or of heights, all metrics and the cost: `jaxurban.plot` has all pictures.

        Args:
          name: a variable, as for `m`; left out, the overview.
          altitude_m: one of `altitudes_m`, or several, a panel each; left out, all, and in the overview the first.
          time: one of `times`; the first if left out.
          time_of_day: one of `times_of_day`; left out, a panel for each, and in the overview the first.
          paths: one from `plan`, several, a batch, or a dictionary by name, each drawn on the map of its altitude.
          width: ``"column"`` or ``"page"`` of a journal (88.9 or 182 mm), or millimetres; left out, a page.
          ax: a cell of another Matplotlib figure (``plt.subplots``), in place of which the picture stands; that part of
            the figure is returned, and ``part.axes`` are its panels.
          title: in place of the picture's own; empty for none.
          cmap: a colour map of Matplotlib, or its name, in place of the maps' own colours.

        Returns:
          A Matplotlib figure, which a notebook shows.

        Raises:
          InputError: no such map, altitude, time or time of day in these maps, a width that is none, axes that are no
            cell of a grid, or a colour map that Matplotlib does not know or that a map of classes cannot have.

        Examples:
          >>> maps.plot("gps", 60).savefig("gps.png")
          >>> maps.plot().savefig("overview.png")
          >>> maps.plot("gps", paths=path).savefig("gps.png")
          >>> import matplotlib.pyplot as plt
          >>> figure, (left, right) = plt.subplots(1, 2, figsize=(10, 5))
          >>> part = maps.plot("gps", 60, ax=left, cmap="cividis", title="GPS")
          >>> part = maps.plot("risk", 60, ax=right, title="Risk")
        """
        from jaxurban import plot  # imported here: it brings Matplotlib

        if name is None:
            one_m: Any = altitude_m  # several are refused
            return plot.plot_overview(
                self, paths, altitude_m=one_m, time=time, time_of_day=time_of_day, **form
            )
        return plot.plot_metric(
            self,
            name,
            altitude_m=altitude_m,
            time=time,
            time_of_day=time_of_day,
            paths=paths,
            **form,
        )

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
        from jaxurban.maps.saving import save_maps  # imported here: it brings the writers

        save_maps(self, Path(folder), layers)
        return Path(folder)


MapsLike = MetricMaps | str | Path  # what `as_maps` takes


def scaled_over(is_free: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Return costs ``[y, x]`` scaled to [0, 1] over the free cells, NaN elsewhere; 0 where all cost the same."""
    lowest = np.min(costs[is_free], initial=np.inf)
    highest = np.max(costs[is_free], initial=-np.inf)
    span = highest - lowest if highest > lowest else 1
    return np.where(is_free, (costs - lowest) / span, np.float32(np.nan))


def as_maps(maps: MapsLike) -> MetricMaps:
    """Return maps as they are, or those in a folder that holds them at one resolution.

    Raises:
      InputError: neither of these, or a folder that `open_maps` cannot open.
    """
    from jaxurban.maps.saving import open_maps  # imported here: it brings the readers

    if isinstance(maps, MetricMaps):
        return maps
    if not isinstance(maps, str | Path):
        raise InputError(
            f"maps must be MetricMaps or the folder that holds them, got {type(maps).__name__}"
        )
    return open_maps(maps)
