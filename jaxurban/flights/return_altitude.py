"""return_altitude: how high a straight flight home must be, from every cell of maps."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.checks import at_least, typed
from jaxurban.errors import InputError
from jaxurban.flights.autopilots import ENOUGH_M, parameter_texts, typed_m
from jaxurban.io.files import whole_file
from jaxurban.io.geotiff import write_cog
from jaxurban.kernels.line.homeward import highest_homeward
from jaxurban.knowledge import Caution, caution_of_guesses, percent
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.paths.ceiling import CEILING_M
from jaxurban.paths.clearance import highest_within, reaches_m
from jaxurban.paths.constraints import Constraints, describe_constraints
from jaxurban.paths.elevation import Elevation
from jaxurban.paths.places import XY, Point, cell_at, one_place
from jaxurban.paths.plan import rules_on
from jaxurban.public import FactsRepr

NAME = "return_altitude"  # of the variable
LONG_NAME = "least altitude of a straight flight home, above the ground at home"
CLEARS = (
    "A return at {typed_m} m above the ground at home clears all that stands from {clear_share:.1%} of the area, at "
    "{all_m} m from every cell with a value; elsewhere set a rally point, or return along the way flown."
)
NO_VALUE = (
    "{} of the cells have no value, as no altitude is known to clear them: their line home meets cells without data or "
    "a roof that nothing bounds, or comes nearer to the maps' border than the clearance."
)


@dataclass(frozen=True, eq=False, repr=False)
class ReturnAltitude(FactsRepr):
    """The least altitude of a straight return home from every cell. ``Y`` rows, ``X`` columns.

    Attributes:
      maps: with `altitude_m` as one more variable, ``return_altitude``, which they save and pictures show.
      home_xy_m: easting and northing of home in the maps' CRS.
      ground_m: elevation of the ground there, above the zero of the terrain; 0 over level ground.
      limits: the clearances and the vehicle.
      ceiling_m: above the ground at home; what to type does not exceed it.

    Examples:
      >>> home = ju.return_altitude(maps, start)
      >>> home.altitude_m.shape, round(float(home.at_lonlat(*goal)))
      ((30, 30), 393)
    """

    maps: MetricMaps
    home_xy_m: tuple[float, float]
    ground_m: float
    limits: Constraints
    ceiling_m: int

    @property
    def altitude_m(self) -> np.ndarray:
        """``[Y, X]`` float32 metres above the ground at home, row 0 in the south; NaN where there is no value."""
        return self.maps.m(NAME)

    def at_lonlat(self, lon: Any, lat: Any) -> np.ndarray:
        """Return the altitude from places, longitude and latitude in degrees; arrays give an array.

        Returns:
          Metres above the ground at home; NaN where there is no value.

        Raises:
          InputError: a place outside the maps.

        Examples:
          >>> round(float(ju.return_altitude(maps, start).at_lonlat(*goal)))
          393
        """
        return self.altitude_m[self.maps.grid.cell_of_lonlat(lon, lat)]

    @property
    def figures(self) -> dict[str, float]:
        """What clears the cells, by name.

        ``highest_m`` is the altitude that clears all cells with a value. ``typed_m`` is that which is to be typed, in
        whole metres, the ceiling at most, and ``clear_share`` the share of all cells from which it clears all.
        """
        highest_m = float(np.nanmax(self.altitude_m))
        typed = min(typed_m(highest_m), self.ceiling_m)
        return {
            "highest_m": highest_m,
            "typed_m": typed,
            "clear_share": float((self.altitude_m <= typed + ENOUGH_M).mean()),
        }

    @property
    def sentence(self) -> str:
        """What a return clears at the altitude that clears all, or else at the ceiling, and what else is possible."""
        figures = self.figures
        return CLEARS.format(**figures, all_m=typed_m(figures["highest_m"]))

    @property
    def facts(self) -> dict[str, str]:
        """What one altitude clears, what is kept, and what to type into autopilots."""
        figures = self.figures
        typed = parameter_texts(figures["typed_m"])
        if figures["clear_share"] < 1:
            share = f" This clears {figures['clear_share']:.1%} of the area."
            typed = {name: text + share for name, text in typed.items()}
        kept = describe_constraints(self.limits.to_dict())
        return {"clears": self.sentence, "kept": kept, **typed}

    @property
    def cautions(self) -> list[Caution]:
        """How many cells have no value, and what the maps guess."""
        share = np.isnan(self.altitude_m).mean()
        cautions = caution_of_guesses(self.maps.guesses)
        return [Caution(NO_VALUE.format(percent(share))), *cautions] if share else cautions

    @typed
    def save(self, file: str | Path) -> Path:
        """Write the map as a GeoTIFF, or the maps with it to a folder.

        Args:
          file: named ``.tif``; or a folder, which gets Zarr and GeoTIFFs as `MetricMaps.save` writes them.

        Returns:
          The file, or the folder.

        Raises:
          InputError: another end of the name, or what cannot be written to.

        Examples:
          >>> ju.return_altitude(maps, start).save("home.tif").name
          'home.tif'
        """
        file = Path(file)
        if not file.suffix:
            return self.maps.save(file, layers=[NAME])
        if file.suffix != ".tif":
            raise InputError(
                f"cannot determine the format of {str(file)!r}: end its name in .tif, or name a folder without an end"
            )
        values = np.asarray(self.altitude_m, np.float32)
        with whole_file(file) as scratch:
            write_cog(
                scratch,
                self.maps.grid,
                values.dtype,
                [values[::-1]],
                is_averaged=False,
                tags={},
                title=LONG_NAME,
                unit="m",
            )
        return file


@typed
def return_altitude(
    maps: MapsLike,
    home: Point | XY,
    *,
    clearance_m: float | None = None,
    vertical_clearance_m: float | None = None,
    ceiling_m: int = CEILING_M,
) -> ReturnAltitude:
    """Return how high a flight must be, from every cell, to fly straight home over all that stands on the way.

    A return climbs straight up, flies level and straight home at one altitude, and descends over home. The value of a
    cell is the least altitude, above the ground at home, at which a straight line from anywhere in the cell to home
    keeps the vertical clearance over the ground and over all that stands in every cell that it touches, or that is
    nearer to such a cell than the clearance. Cells count as for `plan`: what hangs counts from the ground up, roofs of
    guessed height count up to their bound, and the vehicle of the maps' scenario adds its radius to the clearance.
    There is no value where a line meets a cell without data or a roof that nothing bounds.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      home: longitude, latitude in degrees, or an `XY` in the maps' CRS.
      clearance_m, vertical_clearance_m: kept from all that stands, and over it; left out, as in the maps' scenario, or
        0 and 3 m.
      ceiling_m: whole metres above the ground at home, which the result's sentence and what to type do not exceed.

    Returns:
      `ReturnAltitude`.

    Raises:
      InputError: home is outside the maps, or its cell has no value.

    Examples:
      >>> home = ju.return_altitude(maps, start, vertical_clearance_m=10.0)
      >>> print(home.sentence)
      A return at ... m above the ground at home clears all that stands from ... of the area, ...
    """
    at_least("ceiling_m", ceiling_m, 2)  # no autopilot climbs less
    kept = Constraints(clearance_m=clearance_m, vertical_clearance_m=vertical_clearance_m)
    maps, _, limits = rules_on(as_maps(maps), None, kept, "")
    grid = maps.grid
    home_xy_m, home_cell = cell_at(grid, "home", one_place("home", home))
    home_m = np.array(home_xy_m)

    # The highest that must be cleared in each cell, above home's ground.
    ground = Elevation(maps, None)
    ground_m = float(ground.at(home_m))
    vertical_m = np.float32(limits.vertical_m)
    roof_m, limit_m = reaches_m(maps, limits.horizontal_m, "highest")
    top_m = np.maximum(roof_m + vertical_m, limit_m) + (ground.highest_m - np.float32(ground_m))
    top_m = highest_within(top_m, limits.horizontal_m, grid.resolution_m)

    # A cell is closed at the very height of its roof.
    col, row = (home_m - grid.bounds_m[:2]) / grid.resolution_m
    altitude_m = highest_homeward(top_m, (row, col))
    altitude_m = np.nextafter(altitude_m, np.float32(np.inf))
    altitude_m[np.isinf(altitude_m)] = np.nan
    if np.isnan(altitude_m[home_cell]):
        raise InputError(
            "home is beside cells without data or a roof that nothing bounds, or nearer to the maps' border than the "
            "clearance, so that no return can be judged: choose another home, or maps of a wider region"
        )
    variable = ("y", "x"), altitude_m, {"long_name": LONG_NAME, "units": "m"}
    maps = replace(maps, ds=maps.ds.assign({NAME: variable}))
    return ReturnAltitude(maps, tuple(home_m.tolist()), ground_m, limits, ceiling_m)
