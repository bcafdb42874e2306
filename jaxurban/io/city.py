"""City: what stands and who lives in a region, as vectors in one projected CRS."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

import numpy as np
import pandas as pd
import shapely

from jaxurban import settings, wings
from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.issues import LEFT_OUT, ReadIssue, ReadIssues, listed_counts, num_of
from jaxurban.io.learned import Learned
from jaxurban.io.sampling import raster_values
from jaxurban.knowledge import Caution, Guesses, caution_of_guesses
from jaxurban.pictures import MapForm
from jaxurban.public import FactsRepr
from jaxurban.settings import TO_GROUND, Hanging
from jaxurban.world.blocks import Blocks
from jaxurban.world.extent import MAIN_SHARE, main_bounds
from jaxurban.world.footprints import UNKNOWN, Footprints, HeightOrigin
from jaxurban.world.grid import WGS84, Bounds, box_of, transformer
from jaxurban.world.kinds import ALL_KINDS, EFFECTS, MOST_WOOD_M, PLANTS, KindName, Obstacles
from jaxurban.world.raster import Raster

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jaxurban.metrics.gps import Gps
    from jaxurban.metrics.population import Population

NEAR_M = 1.0  # of a place: what is so near counts as there, as wires and walls are thin
WOOD = "wood"  # the kind of what a raster of vegetation holds
MOST_IN = f"{100 * MAIN_SHARE:.0f} % of buildings in"


class Counted(NamedTuple):
    """What of a city counts for something.

    Attributes:
      outlines: None where roofs are a raster.
      plants: a raster of their heights, None without one.
    """

    outlines: Footprints | None
    plants: Raster | None


def joined_credits(*credits: str) -> str:
    """Return credits as one text, each once."""
    return "; ".join(dict.fromkeys(credit for credit in credits if credit))


@typed
@dataclass(frozen=True, repr=False)
class City(FactsRepr):
    """A city in one projected CRS: buildings or a height raster, and optionally blocks and terrain.

    Attributes:
      crs: projected CRS in metres of every polygon.
      extent_m: x_min, y_min, x_max, y_max that the building source covers: beyond it no building is known.
      terrain_extent_m: the same of the terrain, None for flat ground.
      buildings: outlines with heights, or None where ``roofs`` is given.
      structures: what else stands (chimneys, masts, tanks ...), and where something of unknown extent does; None or
        empty for nothing.
      vegetation: raster of heights of plants above ground, NaN where they are not known, or None.
      kinds: of `jaxurban.world.kinds`, those of buildings, structures and vegetation (a ``"wood"``) that count; what is
        of unknown extent always does.
      roofs: raster of roof heights above ground, or None.
      blocks: census blocks, or None without population data.
      terrain: raster of ground elevation, or None for flat ground.
      read_issues: what the readers repaired, guessed or left out, counted by `jaxurban.io.issues.ReadIssue`.
      sources: path by role, for provenance (empty for the synthetic city).
      guesses: what was supposed where the sources are silent, see `jaxurban.knowledge`.
      attribution: the credit that the licence of the sources asks for wherever pictures are shown.
      bounds: west, south, east, north in degrees that the city was read for; None for all that there is.
      area: where the building source knows what stands, within ``extent_m``; None for all of it.
      hanging: what buildings with an underside above the ground do: ``"to_ground"``, they reach it; ``"slabs"``, they
        hang from floor to roof.
      gps, population, heights: settings that the city was read with; maps are made with them where `build_maps` is
        given no others. None: the defaults.
      learned: what is guessed and likely where no height is given, by class of footprint and by kind.

    Raises:
      InputError: neither buildings nor roofs, both, or an unknown way of hanging.

    Examples:
      >>> city
      City(CRS: EPSG:32618; extent: 0.6 x 0.6 km; buildings: 117; census blocks: 28; terrain: flat; credit: ...)
      >>> round(float(city.buildings.height_m.max()))
      390
    """

    crs: str
    extent_m: Bounds
    buildings: Footprints | None = None
    roofs: Raster | None = None
    blocks: Blocks | None = None
    terrain: Raster | None = None
    read_issues: ReadIssues = field(default_factory=dict)
    terrain_extent_m: Bounds | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    attribution: str = ""
    bounds: Bounds | None = None
    area: shapely.Geometry | None = None
    guesses: Guesses = ()
    hanging: Hanging = TO_GROUND
    gps: "Gps | None" = None
    population: "Population | None" = None
    heights: settings.Heights | None = None
    structures: Footprints | None = None
    vegetation: Raster | None = None
    kinds: tuple[KindName, ...] = ALL_KINDS
    learned: Mapping[str, Learned] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that there is one kind of roofs; errors as of the class."""
        if (self.buildings is None) == (self.roofs is None):
            raise InputError(
                "a City needs either buildings (outlines) or roofs (a height raster), and not both"
            )

    @cached_property
    def standing(self) -> Footprints | None:
        """All outlines that count: the buildings and, after them, the structures; None where ``roofs`` is given."""
        return None if self.buildings is None else self.buildings.joined(self.others)

    @cached_property
    def others(self) -> Footprints | None:
        """The structures that count. Those that rays pass reach the ground, as what hangs is solid to rays."""
        if self.structures is None:
            return None
        others = self.structures.take(np.isin(self.structures.kinds, [*self.kinds, UNKNOWN]))
        is_solid = np.array([all(EFFECTS[kind]) for kind in others.kinds], bool)
        return replace(others, min_height_m=others.min_height_m * is_solid)

    @cached_property
    def plants(self) -> Raster | None:
        """``vegetation``, where it counts."""
        return self.vegetation if WOOD in self.kinds else None

    @cached_property
    def counted(self) -> "Counted":
        """All that counts beside a raster of roofs."""
        return Counted(self.standing, self.plants)

    @cached_property
    def hides(self) -> "Counted":
        """What hides satellites: with ``[gps] plants = "hide"`` plants do too."""
        plants = PLANTS if self.gps is not None and self.gps.plants == "hide" else ()
        return self._which(lambda kind: EFFECTS[kind].hides or kind in plants)

    @cached_property
    def returns(self) -> "Counted":
        """What returns a lidar's beam."""
        return self._which(lambda kind: EFFECTS[kind].returns)

    def _which(self, counts: Callable[[str], bool]) -> "Counted":
        """Return what counts of its kind: `counted` itself, if all does."""
        standing, plants = self.counted
        kinds = {kind for kind in EFFECTS if counts(kind)}
        are_counted = plants is None or WOOD in kinds
        if standing is not None:
            is_counted = np.array([kind in kinds for kind in standing.kinds], bool)
            standing = standing.take(is_counted)
            are_counted &= bool(is_counted.all())
        if are_counted:
            return self.counted
        return Counted(standing, plants if WOOD in kinds else None)

    @property
    def facts(self) -> dict[str, str]:
        """CRS, extent of the region, what is known of buildings, people and terrain, and the credit, each as a text.

        The box in which most buildings stand is empty where it is not much smaller than the region.
        """
        region_m = self.extent_m if self.bounds is None else box_of(self.bounds, self.crs)
        x_min, y_min, x_max, y_max = region_m
        buildings = "a height raster"
        main = None
        if self.buildings is not None:
            num_inside = num_of(self.buildings.touches(region_m))
            num_around = len(self.buildings) - num_inside
            buildings = f"{num_inside:,}"
            if num_around:
                buildings += f", and {num_around:,} around"
            solids = self.read_issues.get(ReadIssue.SOLIDS, 0)
            if solids:
                buildings += f", prisms of {solids:,} solids on their lowest vertices among them"
            extent = self.bounds or transformer(self.crs, WGS84).transform_bounds(*region_m)
            main = main_bounds(self.buildings.polygons, self.crs, extent)
        inside = self.structures and self.structures.inside(region_m)
        left_out: dict[str, int] = {reason: self.read_issues.get(reason, 0) for reason in LEFT_OUT}
        return {
            "CRS": self.crs,
            "extent": f"{(x_max - x_min) / 1000:.3g} x {(y_max - y_min) / 1000:.3g} km",
            "buildings": buildings,
            "structures": listed_counts(Counter(inside.named)) if inside else "",
            "left out": listed_counts(left_out),
            MOST_IN: "" if main is None else str(list(main)),
            "census blocks": "" if self.blocks is None else f"{len(self.blocks):,}",
            "terrain": "flat" if self.terrain is None else "a raster",
            "credit": self.attribution,
        }

    @property
    def known_cautions(self) -> list[Caution]:
        """That it rests on ``guesses``."""
        return caution_of_guesses(self.guesses)

    @property
    def known_extent_m(self) -> Bounds:
        """The box that holds everything known, buildings and terrain: beyond it nothing can shadow."""
        if self.terrain_extent_m is None:
            return self.extent_m
        boxes = shapely.box(*self.extent_m), shapely.box(*self.terrain_extent_m)
        return shapely.MultiPolygon(boxes).bounds

    @property
    def known_area(self) -> shapely.Geometry:
        """Where the building source knows what stands: a building far off does not make the land between known."""
        return shapely.box(*self.extent_m) if self.area is None else self.area

    @property
    def known_ground(self) -> shapely.Geometry:
        """Where its buildings and, where it has any, its terrain are known, in its CRS."""
        if self.terrain_extent_m is None:
            return self.known_area
        return shapely.intersection(self.known_area, shapely.box(*self.terrain_extent_m))

    @typed
    def why(self, lon: float, lat: float) -> pd.DataFrame:
        """Return what stands at a place, by which rule, how high it is, and how that is known.

        A thing stands there if its outline is at most 1 m away, as wires and walls are thin; a raster says what its
        pixel holds, and nothing is known where that has no value. **Where nothing stands, the table is headed so and
        holds the nearest thing.** What a file holds and the rules leave out, such as a fence, a pier or a tunnel, is
        not kept and not listed; ``read_issues`` counts it by reason. Whether a kind counts in maps (``kinds``) does not
        matter here.

        Args:
          lon, lat: longitude and latitude of the place in degrees.

        Returns:
          A row for each thing, the highest first, those of unknown height last: ``kind``, or what the file calls
          something of unknown kind; ``rule``, by which it stands, of the [table of kinds](../../model/kinds.md#kinds),
          ``""`` without one; ``height_m`` above the ground, NaN where it is unknown; ``known_by``, how it is known;
          ``likely_m`` and ``highest_m``, which 99 % and all but a few of its kind keep below: the height itself where
          it is known, inf where nothing says; ``min_height_m`` of the underside; ``distance_m`` from the place;
          ``source``, its file; and, if the city has a terrain, ``ground_m``, its elevation.

        Raises:
          InputError: nothing is known at the place, as it lies outside the city.

        Examples:
          >>> city.why(-73.97085, 40.77932)[["kind", "height_m", "known_by"]]
          this stands at -73.970850, 40.779320      kind  height_m            known_by
          0                                     building     390.0  the synthetic city
          1                                     building      25.4  the synthetic city
        """
        place = shapely.Point(transformer(WGS84, self.crs).transform(lon, lat))
        file = self.sources.get("buildings", "")
        layers = (
            ("buildings", self.buildings),
            ("structures", self.structures),
            ("buildings", self._pixel(self.roofs, place, "roof")),
            ("vegetation", self._pixel(self.vegetation, place, WOOD, MOST_WOOD_M)),
        )
        with np.errstate(invalid="ignore"):  # of a place for which the CRS has no coordinates
            things = pd.concat(
                pd.DataFrame(each.facts_at(place)).assign(source=self.sources.get(role, file))
                for role, each in layers
                if each is not None
            )
        nearest_m = things["distance_m"].min()
        is_here = nearest_m <= NEAR_M
        if not (is_here or shapely.intersects(self.known_area, place)):
            raise InputError(
                f"nothing is known at longitude {lon:g}, latitude {lat:g}: give a place in the city, longitude first"
            )
        near = things[things["distance_m"] <= max(NEAR_M, nearest_m)]
        near = near.sort_values("height_m", ascending=False, ignore_index=True)
        if self.terrain is not None:
            x_m, y_m = shapely.get_coordinates(place).T
            near["ground_m"] = raster_values(self.terrain, x_m, y_m, self.crs, "bilinear")[0]
        stands = "this stands" if is_here else "nothing stands"
        return near.rename_axis(columns=f"{stands} at {lon:.6f}, {lat:.6f}")

    def _pixel(
        self, raster: Raster | None, place: shapely.Point, kind: str, limit_m: float = np.inf
    ) -> Footprints | None:
        """Return what a raster of heights holds at a place in the city's CRS; None without one.

        A pixel without a value is of unknown height where anything is known, and 0 m is nothing.

        Args:
          raster: of heights above the ground.
          place: where it is looked at.
          kind: of what it holds.
          limit_m: its bound, where its height is unknown.
        """
        if raster is None:
            return None
        x_m, y_m = shapely.get_coordinates(place).T
        height_m = raster_values(raster, x_m, y_m, self.crs, "nearest")
        zero = np.zeros(1)
        origin = np.where(np.isnan(height_m), HeightOrigin.UNKNOWN, HeightOrigin.RASTER)
        pixel = Footprints(
            np.array([place]),
            np.nan_to_num(height_m),
            zero,
            origin,
            zero,
            np.array([kind]),
            limit_m=np.array([limit_m]),
        )
        return pixel.take((height_m != 0) & shapely.intersects(self.known_area, place))

    @typed
    def plot(self, **form: Unpack[MapForm]) -> "Figure":
        """Return a picture of its heights, and of those that are guessed, before any map is made.

        Args:
          form: width, ax, title and cmap, as in `MetricMaps.plot`.

        Returns:
          A Matplotlib figure, which a notebook shows.

        Examples:
          >>> city.plot().savefig("city.png")
        """
        from jaxurban import plot  # imported here: it brings Matplotlib

        return plot.plot_city(self, **form)

    @classmethod
    @typed
    def from_files(
        cls,
        buildings: str | Path | settings.Buildings,
        *,
        bounds: Sequence[float] | None = None,
        crs: str | None = None,
        population: "Population | None" = None,
        terrain: str | Path | settings.Terrain | None = None,
        gps: "Gps | None" = None,
        vegetation: str | Path | settings.Vegetation | None = None,
        kinds: Sequence[KindName] | None = None,
    ) -> "City":
        """Return the city in a set of files, around a region.

        Args:
          buildings: their file, or ``"sample:lower-manhattan"``, ``"sample:shinjuku"`` or ``"sample:nihonbashi"`` (see
            `sample_city`); or `Buildings`, which also says how the file is read and how its maps treat heights.
            Buildings are kept as far around the region as one of 1,000 m could shadow it from a satellite at the
            elevation mask.
          bounds: west, south, east, north of the region in degrees; left out, what the file of buildings covers.
          crs: projected CRS in metres; left out, the UTM zone of the region's centre.
          population: names census blocks, their people and districts, or rasters of people, and how many people maps
            count when; left out, or without such files, those of the sample city, else none.
          terrain: ground elevation raster; left out, flat.
          gps: satellites, times and elevation mask of the city's maps and skies; left out, those of the sample city,
            else the nominal ones over 5 degrees.
          vegetation: raster of heights of plants above the ground; left out, none.
          kinds: of what stands that count, from `jaxurban.world.kinds`; left out, all.

        Returns:
          The city, its coordinates in metres in ``crs``. What lies around the region is there too.

        Warns:
          GuessWarning: of each of the city's ``guesses``.

        Raises:
          InputError: a file that is missing, unreadable or of the wrong kind, no building in the region, or settings
            of people without their files.

        Examples:
          >>> around = ju.City.from_files("sample:shinjuku", bounds=(139.698, 35.687, 139.703, 35.691))
          >>> around.crs, around.facts["buildings"]
          ('EPSG:32654', '3,052, and 50,419 around')
        """
        if not isinstance(buildings, settings.Buildings):
            buildings = settings.Buildings(buildings)
        if not isinstance(terrain, settings.Terrain):
            terrain = settings.Terrain(terrain)
        if not isinstance(vegetation, settings.Vegetation):
            vegetation = settings.Vegetation(vegetation)
        given: Any = kinds  # `Obstacles` makes a tuple of them
        return wings.read_city(
            buildings,
            bounds=bounds,
            crs=crs,
            population=population,
            terrain=terrain,
            gps=gps,
            vegetation=vegetation,
            kinds=Obstacles(given).under(""),
        )


def seen_by(city: City, gps: "Gps") -> City:
    """Return a city in which plants hide satellites as settings of these say."""
    from jaxurban.metrics.gps import Gps  # imported here: it brings JAX

    own = city.gps or Gps()
    return city if own.plants == gps.plants else replace(city, gps=gps)
