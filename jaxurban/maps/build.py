"""build_maps: a city and a sky in, the metric maps of a region out; and map_inputs, what `all_maps` makes them of."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
import shapely

from jaxurban.checks import positive, typed, values_given
from jaxurban.errors import GuessWarning, InputError, warn
from jaxurban.io.city import City
from jaxurban.io.orbits import look_angles, middle_epoch, read_orbits
from jaxurban.io.rasterise import bands_of, check_has_data
from jaxurban.kernels.engine import Engine, on_host, warn_of_jax
from jaxurban.knowledge import Guesses, GuessKind, guessed, guesses_to, warn_of
from jaxurban.maps.at_once import (
    MapInputs,
    TooLargeError,
    Window,
    free_device_bytes,
    inputs_of,
    skies_of,
    tile_at_once,
)
from jaxurban.maps.memory import check_fits, shape_of_tiles
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.params import PAPER_ALTITUDES_M, MapParams, MetricSettings
from jaxurban.maps.recipe import tile_maps
from jaxurban.maps.task import MapTask, empty_dataset
from jaxurban.maps.tile_scene import TileScene
from jaxurban.maps.tiled import Tiling
from jaxurban.metrics.custom import Layer, check_layers
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.population import check_has_people
from jaxurban.metrics.visibility import SkyView
from jaxurban.progress import Progress, Stage, Stopwatch, reporting
from jaxurban.settings import NOMINAL, Heights
from jaxurban.world.grid import (
    WGS84,
    Grid,
    check_bounds,
    covering_grid,
    transformer,
    where_it_lies,
)
from jaxurban.world.sky import Sky
from jaxurban.world.surface import Surface

PAPER_TIME = "2020-04-27T16:00:00Z"


@typed
def build_maps(
    city: City,
    bounds: Sequence[float] | None = None,
    *,
    grid: Grid | None = None,
    resolution_m: float = 5.0,
    altitudes_m: Sequence[float] = PAPER_ALTITUDES_M,
    oversample: int = 1,
    heights: Heights | None = None,
    layers: Mapping[str, Layer] | None = None,
    engine: Engine = "auto",
    progress: Progress = True,
    **metrics: Unpack[MetricSettings],
) -> MetricMaps:
    """Return the metric maps of a city.

    Args:
      city: from `City.from_files`, `sample_city` or `demo_city`.
      bounds: west, south, east, north in degrees; left out, those of the city, else what its buildings cover.
      grid: the region's grid, instead of bounds and resolution.
      resolution_m: side of a cell.
      altitudes_m: flight altitudes above ground.
      oversample: n: occlusion and lidar on a surface n times finer (odd is best).
      heights: how roofs are rasterised, and how well their heights are known; left out, as the city's `Buildings` say.
      layers: further cost layers, by name: rasters, arrays on the cells of the maps, or functions.
      engine: ``"jax"``; ``"numba"``, where it has a form, and JAX on the host for the rest; or ``"auto"``: JAX, and
        Numba where its form is the quicker one. On a CPU the bits are the same.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).
      gps, lidar, population, risk: settings of the metrics, such as ``gps=Gps(times="2020-04-27T16:00:00Z")``; ``gps``
        and ``population`` left out are those that the city was read with.
      gps_horizontal, gps_vertical, protection, gps_floor: the same of metrics that are made on request, where they are
        given.

    Returns:
      The maps, in memory: one variable for each metric, m from 0 to 1, ``[altitude, y, x]`` with the time (``gps``) or
      the time of day (``population``) in front; see `MetricMaps`.

    Warns:
      GuessWarning: of each guess behind the maps (`MetricMaps.guesses`) that reading the city has not warned of.

    Raises:
      InputError: settings that do not fit the city, too few satellites, or too little memory.

    Examples:
      >>> made = ju.build_maps(city, resolution_m=20.0, altitudes_m=(30.0, 60.0), gps=ju.Gps(mask_deg=10.0))
      >>> made.ds["gps"].shape, made.ds["risk"].shape
      ((1, 2, 30, 30), (2, 30, 30))
    """
    positive("resolution_m", resolution_m)
    if grid is not None and bounds is not None:
        raise InputError("give either bounds or grid, and not both")
    layers = check_layers(layers)
    region = grid if grid is not None else region_of(city, bounds, resolution_m)
    sections = _sections(city, metrics)
    heights = heights or city.heights or Heights()
    params = MapParams(altitudes_m, oversample, heights, sections, engine)
    check_region(city, region, is_own=grid is None and bounds is None)
    sky = view_sky(region, params.gps)
    task = MapTask(city, region, sky, params, layers, bands_of(layers, region, params.altitudes_m))
    check_fits(task)
    with reporting("build_maps", progress) as report:
        return compute_maps(task, stage=Stopwatch(on_stage=report).stage)


def _sections(city: City, metrics: MetricSettings) -> dict[str, Any]:
    """Return the settings of metrics by section, without those that are None.

    ``gps`` and ``population`` are those of the city where none are given, if it was read with any. A warning says where
    nominal satellites take the place of the city's.

    Raises:
      InputError: settings of people for a city without any.
    """
    check_has_people(metrics.get("population"), city.blocks is not None)
    own = {"gps": city.gps, "population": city.population}
    gps = metrics.get("gps")
    if gps and city.gps and gps.orbits == NOMINAL != city.gps.orbits:
        warn(
            "gps names no orbits, so nominal satellites take the place of those that the city was read with: to keep "
            "these, write gps=dataclasses.replace(city.gps, ...) with what is to differ",
            GuessWarning,
        )
    return values_given(own) | values_given(metrics)


def check_region(city: City, region: Grid, is_own: bool = False) -> None:
    """Check that a region can be mapped.

    Args:
      city: what is mapped.
      region: grid of the maps.
      is_own: whether the region is the city's own, which was accepted when the city was read.

    Raises:
      InputError: the region has another CRS than the city, or lies wholly beside it.
    """
    if region.crs != city.crs:
        raise InputError(
            f"the grid is in {region.crs} and the city in {city.crs}: build the grid in the city's CRS"
        )
    box = shapely.box(*region.bounds_m)
    if not is_own and not shapely.intersects(box, shapely.box(*city.known_extent_m)):
        raise InputError(
            "the region and the city do not meet: check the bounds (west, south, east, north)"
        )


def region_of(city: City, bounds: Sequence[float] | None, resolution_m: float) -> Grid:
    """Return the grid of maps of a city, in its CRS.

    Args:
      city: what is mapped.
      bounds: west, south, east, north in degrees; None for the city's own or, where it has none, what its buildings
        cover.
      resolution_m: side of a cell.

    Raises:
      InputError: bounds that are no box, or that do not meet the city.
    """
    if bounds is not None:
        of_city = transformer(city.crs, WGS84).transform_bounds(*city.known_extent_m)
        if not shapely.box(*check_bounds(bounds)).intersects(shapely.box(*of_city)):
            where = where_it_lies(of_city, bounds)
            raise InputError(f"the region and the city do not meet: {where}")
    bounds = city.bounds if bounds is None else bounds
    if bounds is not None:
        return Grid.from_bounds(bounds, resolution_m, city.crs)
    return covering_grid(city.extent_m, resolution_m, city.crs)


def view_sky(region: Grid, gps: Gps) -> Sky:
    """Return the sky of a region: the satellites at or above the mask at any time.

    Args:
      region: the sky is seen from its centre, unless the settings name a reference point.
      gps: the settings. Without times, element sets from files are taken at the middle of their own epochs, and the
        nominal constellation at the paper's time.

    Returns:
      The sky, with what was guessed of its time and its satellites.

    Raises:
      InputError: unreadable or stale orbits, or no satellite above the mask at some time.
    """
    satellites = read_orbits(gps.orbits)

    # The times, and what is guessed where the settings name none.
    times = gps.utc_times
    own_time = middle_epoch(satellites) if times is None else None
    is_papers = times is None and own_time is None
    times = times or (own_time or PAPER_TIME,)
    guesses: Guesses = ()
    if own_time is not None:
        guesses += guessed(GuessKind.ELEMENTS_TIME, time=own_time)
    if satellites.nominal_systems:
        more = " and later" if len(times) > 1 else ""
        systems = " and ".join(system.upper() for system in satellites.nominal_systems)
        time = times[0] + (", the paper's time" if is_papers else more)
        guesses += guessed(GuessKind.NOMINAL_SKY, systems=systems, time=time)

    lon_deg, lat_deg = gps.reference or region.centre_lonlat
    sky = look_angles(
        satellites,
        times,
        lon_deg,
        lat_deg,
        convergence_rad=region.convergence_rad(lon_deg, lat_deg),
        max_age_days=gps.max_age_days,
    )
    lost = np.array(sky.names)[np.isnan(sky.elevation_rad).any(axis=0)]
    if lost.size:
        guesses += guessed(GuessKind.WITHOUT_PLACE, satellites=", ".join(lost))
    sky = sky.under(gps.mask_deg)

    num_in_view = sky.is_in_view.sum(axis=1)
    if not num_in_view.all():
        time = sky.times[np.argmin(num_in_view)]
        raise InputError(
            f"no satellite is above the elevation mask of {gps.mask_deg} degrees at {time}: "
            "lower [gps] mask_deg, choose another time, or check the orbits"
        )
    return replace(sky, guesses=guesses)


def compute_maps(
    task: MapTask,
    surface: Surface | None = None,
    stage: Stage = nullcontext,
    device_bytes: float | None = None,
) -> MetricMaps:
    """Return the maps of a task, made in memory, and warn of the guesses behind them.

    Args:
      task: city, grid, sky and settings.
      surface: the task's for the host, where it is made already; left out, it is made here.
      stage: gives the context that the work on each stage runs in.
      device_bytes: let JAX's first device make the maps at once within so much of its memory, the CPU too; left out,
        a GPU does so for large regions (`jaxurban.maps.at_once.free_device_bytes`).
    """
    guesses = task.all_guesses
    warn_of(guesses, known=task.city.guesses)
    warn_of_jax(task.params.engine)
    ds = empty_dataset(task).assign_attrs(guesses=guesses_to(guesses))
    device_bytes = device_bytes or free_device_bytes(task)
    with on_host():
        if device_bytes is None:
            tiles: Iterable[Any] = [(..., TileScene(task, surface or task.surface()))]
        else:
            tiles = _tiles_at_once(task, device_bytes, stage)
        for window, tile in tiles:
            for name, place, values in tile_maps(tile, stage):
                target = ds[name].values[place][window]
                num_rows, num_cols = target.shape
                target[:] = values[-num_rows:, :num_cols]
    check_has_data([ds["has_data"].values], task.city)
    base = task.city.sources.get("buildings")
    return MetricMaps(ds, base=base)


def _tiles_at_once(
    task: MapTask, device_bytes: float, stage: Stage
) -> Iterator[tuple[Window, TileScene]]:
    """Yield what a device makes of a region, as one tile or, where that does not fit, as several.

    Raises:
      TooLargeError: even the smaller tiles need more memory.
    """
    shapes = task.region.shape, shape_of_tiles(task)
    for shape in shapes:
        tiling = Tiling.over(task.region, task.region, shape)
        try:
            for tile in tiling.region_tiles:
                window = tiling.reported(tile)
                grid = tiling.grid_of(tile)
                yield window, tile_at_once(task, grid, window, stage, device_bytes)
            return
        except TooLargeError:
            if shape == shapes[-1]:
                raise


@typed
def map_inputs(
    city: City,
    grid: Grid,
    *,
    altitudes_m: Sequence[float] = PAPER_ALTITUDES_M,
    **metrics: Unpack[MetricSettings],
) -> tuple[MapInputs, SkyView]:
    """Return a city and its skies made ready for `all_maps`; the skies of all times are stacked along them.

    Args:
      city: what is mapped.
      grid: of the maps, such as that of maps.
      altitudes_m, gps, lidar, population, risk, gps_horizontal, gps_vertical, protection, gps_floor: as for
        `build_maps`.

    Returns:
      The inputs, a pytree of the city's surface and the settings, and the skies, a pytree whose leaves have the times
      first, ``[T, ...]``.

    Raises:
      InputError: a grid off the city, unreadable or stale orbits, or settings that `all_maps` does not know.

    Examples:
      >>> inputs, skies = ju.grad.map_inputs(city, maps.grid, altitudes_m=(60.0,))
      >>> list(inputs.metrics), skies.num.shape
      (['gps', 'lidar', 'population', 'risk'], (1,))
    """
    sections = _sections(city, metrics)
    params = MapParams(altitudes_m, heights=city.heights or Heights(), sections=sections)
    check_region(city, grid)
    task = MapTask(city, grid, view_sky(grid, params.gps), params)
    inputs = inputs_of(task)
    return inputs, skies_of(task, inputs.surface)
