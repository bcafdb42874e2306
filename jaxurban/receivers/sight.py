"""Sight: which satellites places in a city see, by its exact outlines."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely
from numpy.typing import ArrayLike

from jaxurban.errors import InputError
from jaxurban.io.city import City, seen_by
from jaxurban.knowledge import Caution, GuessKind, caution_of_guesses, guessed
from jaxurban.maps.build import region_of, view_sky
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.params import MapParams
from jaxurban.maps.run import gps_of, load_city, scenario_grid
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.sources import CityLike, folder_of, scenario_of
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import DOPS, FIX, Gps, has_no_fix
from jaxurban.metrics.population import Population
from jaxurban.paths.places import XY, Point, one_place
from jaxurban.public import listed
from jaxurban.receivers.outlines import Hiding
from jaxurban.receivers.rule import HIDDEN, SEEN, UNKNOWN
from jaxurban.receivers.track import NUM_VISIBLE, quality_along
from jaxurban.settings import Heights
from jaxurban.world.grid import Grid
from jaxurban.world.known import Rays
from jaxurban.world.sky import Sky

RESOLUTION_M = 5.0  # of the grid of a City, as `build_maps` makes it


class Look(NamedTuple):
    """Which satellites ``N`` places see, each at one of the times of a sky.

    Attributes:
      sky: where the satellites stand.
      epoch: for each row of ``rows`` the number of its place, which is a row of ``dops``.
      rows: a row for each place and each satellite above the mask, with the columns of `SkyAt.table`.
      dops: a row for each place, with the columns of `SkyAt.dops`.
      is_outdoors: ``[N]`` bool: the place lies in no building.
      may_have_fix: ``[N]`` bool: no position fix from what is seen, but one if all unknown satellites were seen too.
    """

    sky: Sky
    epoch: np.ndarray
    rows: pd.DataFrame
    dops: pd.DataFrame
    is_outdoors: np.ndarray
    may_have_fix: np.ndarray


@dataclass(frozen=True, eq=False)
class Sight:
    """A city to look at the sky from, and how maps of it are made.

    Attributes:
      city: what stands.
      region: grid of the maps.
      params: of the maps; of their sections that of the satellites.
    """

    city: City
    region: Grid
    params: MapParams

    def __post_init__(self) -> None:
        object.__setattr__(self, "city", seen_by(self.city, self.params.gps))

    @classmethod
    def of(
        cls,
        where: CityLike,
        gps: Gps | None,
        sources: str | Path | None,
    ) -> "Sight":
        """Return the sight of a city, of maps or of their folder, see `jaxurban.sky`.

        Args:
          where: a city; or maps or their folder, and then the city is read again from the files of their run.
          gps: satellites and elevation mask; None for those of the city or of the maps.
          sources: folder of the files that the run recorded; None to look for them beside the maps.

        Raises:
          InputError: sources beside a city, or files that are gone or were changed.
        """
        if isinstance(where, City):
            if sources is not None:
                raise InputError("sources are of maps, and where is a city: leave sources out")
            heights = replace(where.heights or Heights(), height_samples=0)
            params = MapParams(heights=heights, sections={"gps": gps or where.gps or Gps()})
            region = region_of(where, None, RESOLUTION_M)
            return cls(where, region, params)

        scenario = scenario_of(folder_of(where), sources)
        resolution_m = where.grid.resolution_m if isinstance(where, MetricMaps) else None
        return cls.of_scenario(scenario, scenario_grid(scenario, resolution_m), gps)

    @classmethod
    def of_scenario(cls, scenario: Scenario, region: Grid, gps: Gps | None = None) -> "Sight":
        """Return the sight of the city that a scenario names, without its people.

        Args:
          scenario: of maps.
          region: their grid.
          gps: as for `of`.
        """
        heights = replace(scenario.buildings, height_samples=0)
        sections = {"gps": gps or gps_of(scenario)}
        params = replace(scenario.map_params, heights=heights, sections=sections)
        no_people = scenario.model_copy(update={"population": Population()})
        return cls(load_city(no_people), region, params)

    def task(
        self,
        times: Sequence[str] | None,
        altitude_m: float,
        reference: tuple[float, float] | None,
    ) -> MapTask:
        """Return the task of making maps of the city at some times and one altitude, with its skies.

        Args:
          times: UTC, one or more; None for those that the settings of the satellites name.
          altitude_m: of the maps above the ground.
          reference: longitude, latitude in degrees where look angles are taken; None for that of the settings.
        """
        gps = replace(self.params.gps, series="epochs", bounds=False)
        if times is not None:
            gps = replace(gps, times=tuple(times), step_s=None)
        if reference is not None:
            gps = replace(gps, reference=reference)
        params = replace(self.params, altitudes_m=(altitude_m,), sections={"gps": gps})
        return MapTask(self.city, self.region, view_sky(self.region, gps), params)

    @cached_property
    def hiding(self) -> Hiding:
        """What can hide satellites."""
        return Hiding(self.city, self.city.known_ground)

    def look(
        self,
        xy_m: np.ndarray,
        altitude_m: ArrayLike,
        times: Sequence[str] | None,
        sky: np.ndarray | None = None,
    ) -> Look:
        """Return which satellites places see.

        Args:
          xy_m: ``[2, N]`` easting and northing of the places; ``[2, 1]`` for one place at all times.
          altitude_m: above the ground, one for each place or one for all.
          times: as for `task`.
          sky: ``[N]`` number of the time at which each place is looked from; None for one place at all times, each of
            which then counts as a place.

        Raises:
          InputError: no satellite above the mask.
        """
        # The skies that the middle of the places sees.
        lonlat = self.region.lonlat_of_xy(*xy_m.mean(axis=1).tolist())
        task = self.task(times, float(np.min(altitude_m)), lonlat)
        sky = np.arange(task.num_times) if sky is None else sky
        x_m, y_m, height_m, _ = np.broadcast_arrays(*xy_m, altitude_m, sky)
        num = len(sky)

        # A ray from each place to each satellite in view; an epoch is a place at its time.
        epoch, satellite = np.nonzero(task.sky.is_in_view[sky])
        azimuth_rad = task.sky.azimuth_rad[sky[epoch], satellite]
        elevation_rad = task.sky.elevation_rad[sky[epoch], satellite]
        rays = Rays(x_m[epoch], y_m[epoch], azimuth_rad, elevation_rad)
        behind = self.hiding.behind(rays, height_m[epoch])
        state = behind.pop("state").to_numpy()

        # Which satellites are seen, ``[N, S]`` of S satellites in all, and whether each place is outdoors.
        is_seen = np.zeros((num, len(task.sky.names)), bool)
        is_seen[epoch, satellite] = state == SEEN
        is_outdoors = np.ones(num, bool)
        is_outdoors[epoch[behind["roof_distance_m"] == 0]] = False

        # The table of rays. Azimuths are from grid north, which the convergence turns from true north.
        true_rad = azimuth_rad + self.region.convergence_rad(*lonlat)
        rows = {
            "satellite": np.array(task.sky.names)[satellite],
            "system": np.array(task.sky.systems)[satellite],
            "azimuth_deg": np.degrees(true_rad % math.tau),
            "grid_azimuth_deg": np.degrees(azimuth_rad),
            "elevation_deg": np.degrees(elevation_rad),
            "state": state,
        }

        # The table of places.
        quality = quality_along(task, sky, is_seen)
        dops = {NUM_VISIBLE: quality[NUM_VISIBLE].astype(int)}
        for name in (HIDDEN, UNKNOWN):
            dops[f"num_{name}"] = np.bincount(epoch[state == name], minlength=num)
        dops |= {name: quality[name] for name in DOPS}

        # Where satellites that are unknown decide on the fix.
        lost = np.flatnonzero(has_no_fix(quality[FIX]))
        is_seen[epoch, satellite] |= state == UNKNOWN
        hdop_at_best = quality_along(task, sky[lost], is_seen[lost])[FIX]
        may_have_fix = np.zeros(num, bool)
        may_have_fix[lost] = ~has_no_fix(hdop_at_best)
        ray_rows = pd.DataFrame(rows).join(behind)
        return Look(task.sky, epoch, ray_rows, pd.DataFrame(dops), is_outdoors, may_have_fix)


def xy_of(name: str, places: Sequence[Point], grid: Grid) -> np.ndarray:
    """Return ``[2, N]`` easting and northing of places in degrees or in metres (`XY`).

    Args:
      name: of the argument that holds the places, for messages.
      places: ``N`` of them, at least one.
      grid: in whose CRS the result is.

    Raises:
      InputError: no place, one that is not two numbers, or all with longitude and latitude swapped.
    """
    checked = [one_place(name, place) for place in places]
    coordinates = np.array([place[:2] for place in checked], float).reshape(-1, 2).T
    is_xy = np.array([isinstance(place, XY) for place in checked], bool)
    lonlat = np.where(is_xy, 0.0, coordinates)  # what is in metres already is not converted
    xy_m = np.where(is_xy, coordinates, grid.xy_of_lonlat(*lonlat))
    if not checked or not np.isfinite(xy_m).all():
        raise InputError(
            f"{name} must be longitude, latitude in degrees in or near the city, got {listed([*map(str, places)])}"
        )
    if grid.is_swapped(*lonlat):
        raise InputError(f"{name}: {grid.outside_said(*lonlat[:, 0])}")
    return xy_m


def cautions_of(sight: Sight, look: Look, xy_m: np.ndarray) -> list[Caution]:
    """Return what whoever uses the skies of places must know: guesses, what is unknown, and places without a sky.

    Args:
      sight: the city that is looked at.
      look: what the places see.
      xy_m: ``[2, N]`` of the places, or ``[2, 1]`` of one place at all times.
    """
    rows = look.rows
    num = len(look.dops)

    # What is guessed: of the city, of its satellites, and heights of the roofs that hide some.
    guesses = sight.city.guesses + look.sky.guesses
    if not sight.city.sources:  # the synthetic city has no real sky
        guesses = tuple(each for each in guesses if each.kind is not GuessKind.NOMINAL_SKY)
    num_guessed = rows["roof_is_guessed"].sum()
    if num_guessed:
        guesses += guessed(GuessKind.HIDING_ROOFS, number=int(num_guessed), of=len(rows))
    cautions = caution_of_guesses(guesses)

    # Satellites that are unknown.
    num_unknown = (rows["state"] == UNKNOWN).sum()
    if num_unknown:
        sentence = (
            f"{num_unknown} of {len(rows)} satellites are unknown: their rays leave the known buildings or "
            "terrain"
        )
        cautions.append(Caution(f"{sentence}."))

    # Places that are outside, indoors or without a fix.
    is_outside = ~shapely.intersects_xy(sight.city.known_ground, *xy_m)
    faults = {
        "outside what is known of the city": np.broadcast_to(is_outside, num),
        "in a building, where all that is known is hidden": ~look.is_outdoors,
        "without a position fix": has_no_fix(look.dops[FIX].to_numpy()) & ~look.may_have_fix,
    }
    for fault, has_fault in faults.items():
        if has_fault.any():
            which = "The place is" if num == 1 else f"{has_fault.sum()} of {num} rows are"
            cautions.append(Caution(f"{which} {fault}.", "limit"))
    num_open = look.may_have_fix.sum()
    if num_open:
        which = "the place has" if num == 1 else f"{num_open} of {num} rows have"
        reason = "satellites that are unknown decide on it"
        cautions.append(Caution(f"It is not known whether {which} a position fix: {reason}."))
    return cautions
