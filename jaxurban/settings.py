"""Settings that are no metric's own: frozen classes, most of them a section of a scenario, with defaults and checks.

The same objects are arguments of the functions of Python. A metric's section is beside the metric. What routes are
planned under where the caller leaves it out is here too; docs/model/departures.md lists every departure from the paper.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from jaxurban.checks import at_least, finite, positive, typed, values_given
from jaxurban.errors import InputError

if TYPE_CHECKING:
    import numpy as np

CostKind = Literal["cell", "line"]
Diagonal = Literal["both-free", "always"]
Objective = Literal["weighted", "distance"]
ObstacleRule = Literal["touched", "centre"]
Preset = Literal["", "paper"]
UnknownHeights = Literal["guess", "likely", "highest"]
PlannerName = Literal[
    "ptp",
    "astar",
    "astar-dist",
    "astar-plus",
    "bitstar-dist",
    "bitstar-plus",
    "theta-star",
    "astar-volume",
]
HeuristicName = Literal[
    "auto",
    "none",
    "euclidean",
    "octile",
    "tiles",
    "landmarks",
    "exact",
    "plus",
    "plus-printed",
    "plus-printed-from-0",
]
MissionEnd = Literal["land", "return", "none"]
FlownBy = Literal["ardupilot", "px4"]  # what a mission's file may leave open
Backend = Literal["auto", "numba", "jax"]  # what searches
OnGround = bool | Literal["goal"]  # which ends of a path must be free down to the ground
SampleName = Literal["lower-manhattan", "shinjuku", "nihonbashi"]


CLEARANCES = ("clearance_m", "vertical_clearance_m")
NOMINAL = "nominal"  # GPS satellites without a file of elements
FIRST_YEAR, LAST_YEAR = 1980, 2200  # GPS time begins in 1980; xarray's nanoseconds end in 2262
MOST_SAMPLES = 1000
# The tallest building stands at 828 m: more is a slip of the keyboard or of the unit.
MAX_HEIGHT_M = 1000.0
Hanging = Literal["to_ground", "slabs"]
Unit = Literal["m", "ft", "cm", "mm"]
TO_GROUND, SLABS = get_args(Hanging)
FULL_TURN_DEG = 180.0
PREFIX = "vehicle_"  # of its entries among the constraints that a path was planned under


def parse_time(time: "str | datetime | np.datetime64") -> datetime:
    """Return a time in UTC, to the microsecond; a time without an offset is taken as UTC.

    Args:
      time: an ISO 8601 text, or a time of Python or NumPy.

    Raises:
      InputError: it is no such time, or lies outside the years `FIRST_YEAR` to `LAST_YEAR`.
    """
    # Python's time; ValueError comes from a text of another form, and OverflowError from an offset at an end of time.
    try:
        if not isinstance(time, str | datetime):
            time = str(time.astype("datetime64[us]"))
        parsed = time if isinstance(time, datetime) else datetime.fromisoformat(time)
        parsed = parsed.replace(tzinfo=UTC) if parsed.tzinfo is None else parsed.astimezone(UTC)
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{str(time)!r} is not a time: write it as 2020-04-27T16:00:00Z"
        ) from error
    if not FIRST_YEAR <= parsed.year <= LAST_YEAR:
        raise InputError(
            f"{str(time)!r} is not a time between the years {FIRST_YEAR} and {LAST_YEAR}"
        )
    return parsed


def iso_utc(time: "str | datetime | np.datetime64") -> str:
    """Return a time (as for `parse_time`) as ISO 8601 UTC with a trailing Z."""
    parsed = parse_time(time)
    return parsed.isoformat().replace("+00:00", "Z")


def time_said(time: str) -> str:
    """Return an ISO time in words: date, hour and minute."""
    return f"{time[:10]} {time[11:16]} UTC"


def not_negative(name: str, value: float, unit: str = "metres") -> float:
    """Return a number that must not be below 0, as a float.

    Raises:
      InputError: the value is below 0, or no finite number.
    """
    number = finite(name, value, unit)
    if number < 0:
        raise InputError(f"{name} must be 0 or a positive number of {unit}, got {number:g}")
    return number


def as_tuple(values: Any) -> tuple:
    """Return what is one value or several of them as a tuple."""
    if isinstance(values, Iterable) and not isinstance(values, str | Path):
        return tuple(values)
    return (values,)


@typed
@dataclass(frozen=True)
class HeightStd:
    """Standard deviation of a building's height by its origin, metres; 0: known exactly.

    The defaults are rules of thumb for low and middle heights; give your source's own where it states them. Among OSM
    buildings that carry both, height minus 3 m x levels varies by 4.5 m (robust; mean +6.6 m) in Lower Manhattan, by
    7.4 m (+3.2 m) up to 8 levels there and by 5.6 m (+4.8 m) in Boston. Most of that comes from towers and from counts
    that leave parts out. Offsets do not belong to this class: change ``level_height_m`` and ``default_height_m``
    instead.

    Attributes:
      height: a tag or column: values are rounded to a metre and leave open whether a parapet or a machine room counts.
      levels: number of levels x level height: a storey more or less (ground floors and roofs differ).
      default: nothing known but that a building stands: half of what is guessed of houses; more among towers. Also of
        decks whose height is guessed by their layer.
      raster: a height raster, where a component of touching pixels above 0 counts as one building.

    Raises:
      InputError: a value that is negative or not finite.

    Examples:
      >>> heights = ju.Heights(height_std_m=ju.HeightStd(levels=4.5), height_samples=20)
      >>> heights.height_std_m
      HeightStd(height=1.0, levels=4.5, default=5.0, raster=1.0)
    """

    height: float = 1.0
    levels: float = 3.0
    default: float = 5.0
    raster: float = 1.0

    def __post_init__(self) -> None:
        for item in fields(self):
            not_negative(f"height_std_m {item.name}", getattr(self, item.name))


@typed
@dataclass(frozen=True, kw_only=True)
class Heights:
    """How far maps spread as building heights are not known exactly.

    Attributes:
      height_std_m: how well heights are known.
      height_samples: draws of heights over which the spread of the metrics is made too; 0: none.

    Raises:
      InputError: a number of samples that makes no spread.

    Examples:
      >>> heights = ju.Heights(height_samples=4)
      >>> spread = ju.build_maps(city, grid=maps.grid, altitudes_m=(60.0,), heights=heights)
      >>> [name for name in spread.ds if name.endswith("_std")]
      ['gps_std', 'lidar_std', 'risk_std']
    """

    height_std_m: HeightStd = field(default_factory=HeightStd)
    height_samples: int = 0

    def __post_init__(self) -> None:
        if self.height_samples != 0 and not 2 <= self.height_samples <= MOST_SAMPLES:
            raise InputError(
                f"height_samples must be 0, for none, or from 2 to {MOST_SAMPLES:,} (each makes all maps again, and a "
                f"tenth of them are held in memory), got {self.height_samples}"
            )


@typed
@dataclass(frozen=True)
class Buildings(Heights):
    """A file of buildings, and how it is read.

    Attributes:
      source: OpenStreetMap (``.osm.pbf``, ``.osm``, JSON of the Overpass API), outlines (``.geojson``, ``.geojsonl``,
        ``.gpkg``, ``.shp``, ``.fgb``, ``.parquet``, ``.csv`` with WKT), packed as ``.gz`` or ``.bz2`` or not, or a
        height raster (``.tif``, ``.asc``, ``.img``), in any CRS that the file declares; CityGML or CityJSON,
        one file, or a folder or ``.zip`` of tiles;
        ``"sample:lower-manhattan"``, ``"sample:shinjuku"`` or ``"sample:nihonbashi"``, which are in the package; of a
        scenario ``"synthetic"`` too.
      kind: of a raster: ``"height"`` above ground, or ``"surface"`` (a DSM), elevations from which the terrain is
        taken; trees are in it too.
      default_height_m: height of a building without a usable height or levels; left out, the median of those with a
        footprint as large (`City.learned`).
      highest_m: what no building of unknown height exceeds there, as far as you know, or by kind, such as
        ``{"building": 40.0, "tree": 25.0}``; paths and checks rest on it. Left out, the bounds of the table of kinds.
      level_height_m: height of one level.
      allow: ``"none"`` accepts a region without a single building, ``"high"`` heights that look like elevations: of
        towers alone, or above that of the ground.
      hanging: ``"slabs"``: parts above an underside and areas of bridges hang over the ground (see the page on the
        model); ``"to_ground"``: they reach it.
      credit: what the licence of the file asks for; OSM's is known.
      height_column: of a table of outlines: the column of roofs above the ground, or, with ``ground_column``, above the
        sea; left out, known by its name or its publisher (`jaxurban.cities.columns`), else asked for.
      ground_column: elevation of the ground, in the same unit.
      levels_column: number of levels; left out, known by its name.
      unit: of numbers in ``height_column`` that name none.
      crs: of the coordinates of outlines or a city model, such as ``"EPSG:28992"``, where the file declares none or a
        wrong one, which it replaces.
      heights: ``"estimated"``: a model made them, so each is a guess that may be far too low; ``"measured"``: none is
        a model's. Left out, as the file says it (`jaxurban.cities.estimates`).

    Raises:
      InputError: a height setting that is not above 0, or above `MAX_HEIGHT_M`, an unknown kind or unit, a
        ``height_column`` without its ``unit``, or that or ``ground_column`` without it.

    Examples:
      >>> file = ju.Buildings("sample:shinjuku", hanging="slabs")
      >>> ju.City.from_files(file).hanging
      'slabs'
    """

    source: str | Path
    kind: Literal["height", "surface"] = "height"
    default_height_m: float | None = None
    level_height_m: float = 3.0
    allow: tuple[Literal["none", "high"], ...] = ()
    hanging: Hanging = TO_GROUND
    credit: str = ""
    height_column: str | None = None
    ground_column: str | None = None
    levels_column: str | None = None
    unit: Unit | None = None
    crs: str | None = None
    highest_m: float | Mapping[str, float] | None = None
    heights: Literal["measured", "estimated"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        has_unit = bool(self.unit)
        if bool(self.height_column) != has_unit or (self.ground_column and not has_unit):
            raise InputError(
                "height_column and unit go together, and ground_column only with them: give both, or none of the three"
            )
        highest_m = _by_kind(self).items()
        heights_m = {f"highest_m of {kind!r}": height_m for kind, height_m in highest_m}
        for name in ("default_height_m", "level_height_m"):
            heights_m[name] = getattr(self, name)
        for name, height_m in values_given(heights_m).items():
            if not 0 < height_m <= MAX_HEIGHT_M:
                raise InputError(
                    f"{name} must be above 0 and at most {MAX_HEIGHT_M:g} metres, got {height_m}"
                )


def _by_kind(heights: Heights | None) -> Mapping[str, float]:
    """Return ``highest_m`` of settings by kind; empty where nothing is said."""
    highest_m = getattr(heights, "highest_m", None)
    return highest_m if isinstance(highest_m, Mapping) else values_given({"building": highest_m})


def highest_of(heights: Heights | None, kind: str) -> float:
    """Return what the user says that nothing of a kind exceeds, metres above the ground; inf where he says nothing."""
    return _by_kind(heights).get(kind, math.inf)


@typed
@dataclass(frozen=True)
class Terrain:
    """Ground elevation.

    Attributes:
      source: a raster; left out, the ground is flat.
      credit: what its licence asks for.

    Examples:
      >>> ju.Terrain("ground.tif", credit="USGS 3DEP")
      Terrain(source='ground.tif', credit='USGS 3DEP')
    """

    source: str | Path | None = None
    credit: str = ""


@typed
@dataclass(frozen=True)
class Vegetation:
    """Plants as a raster, beside those of the file of buildings.

    Attributes:
      source: a raster of heights above the ground in metres (a canopy model, CHM); left out, none. Beyond it, and
        where it has no data though it writes 0 where nothing grows, plants are unknown.
      credit: what its licence asks for.

    Examples:
      >>> ju.Vegetation("canopy.tif", credit="City of Gothenburg")
      Vegetation(source='canopy.tif', credit='City of Gothenburg')
    """

    source: str | Path | None = None
    credit: str = ""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What a preset decides where nothing else does.

    Attributes:
      cost_model, obstacles, clearance_m, vertical_clearance_m, unknown_heights: as in `Planning`, none of them left
        out.
    """

    cost_model: CostKind = "line"
    obstacles: ObstacleRule = "touched"
    clearance_m: float = 0.0
    vertical_clearance_m: float = 3.0
    unknown_heights: UnknownHeights = "likely"


PRESETS = {
    "": Rules(),
    "paper": Rules(
        cost_model="cell", obstacles="centre", vertical_clearance_m=0.0, unknown_heights="guess"
    ),
}


@typed
@dataclass(frozen=True, kw_only=True)
class Planning:
    """How paths are sought, as given: a scenario's ``[planning]``, and the default of every such argument.

    Attributes:
      preset: ``"paper"`` for the paper's ``cell``, obstacles at centres and no clearance where those are left out.
      planner: ``"ptp"``, ``"astar"``, ``"theta-star"`` ...
      cost_model: kind of `jaxurban.CostModel`; left out: ``"line"``.
      obstacles: where planners may fly (`jaxurban.maps.metric_maps.MetricMaps`); left out: ``"touched"``.
      clearance_m: horizontal distance from buildings as high as the path; left out: 0 m.
      vertical_clearance_m: height over roofs; left out: 3 m.
      unknown_heights: how high roofs of unknown height count: ``"highest"``, their bound; ``"likely"``, what 99 % of
        their kind keep below; ``"guess"``, no more than the guess that the maps show. Left out: ``"likely"``, and
        ``"highest"`` in what the command ``plan`` writes to be flown.
      budget_s: seconds that a search may take.
      seed: of sampling planners; their budget is a time, so that one seed gives another route in each run.

    Raises:
      InputError: an unknown preset, a clearance below 0, a budget that is not above 0, or a seed below 0.

    Examples:
      >>> planning = ju.Planning(preset="paper", clearance_m=5.0)
      >>> planning.cost_model, planning.rules.cost_model, planning.rules.clearance_m
      (None, 'cell', 5.0)
    """

    preset: Preset = ""
    planner: PlannerName = "astar"
    cost_model: CostKind | None = None
    obstacles: ObstacleRule | None = None
    clearance_m: float | None = None
    vertical_clearance_m: float | None = None
    unknown_heights: UnknownHeights | None = None
    budget_s: float = 10.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers; `typed` has checked the names."""
        for name in CLEARANCES:
            metres = getattr(self, name)
            if metres is not None:  # None: left out
                not_negative(name, metres)
        if not self.budget_s > 0:
            raise InputError(f"budget_s must be a positive number of seconds, got {self.budget_s}")
        at_least("seed", self.seed)

    @property
    def given(self) -> dict[str, Any]:
        """The settings that are not the defaults."""
        return {
            name: value for name, value in vars(self).items() if value != getattr(DEFAULTS, name)
        }

    @property
    def rules(self) -> Rules:
        """What is given here, and what the preset says of the rest."""
        settings = {item.name: getattr(self, item.name) for item in fields(Rules)}
        return replace(PRESETS[self.preset], **values_given(settings))


DEFAULTS = Planning()


@typed
@dataclass(frozen=True)
class Vehicle:
    """What flies, as ``[vehicle]`` of a scenario says it; what is left out sets no limit.

    Climbs, descents and turns beyond the limits are reported only (by `cautions`, and in the time of `explain`), as a
    multirotor slows down for them and may then fly them all. Its radius belongs to the clearance.

    Attributes:
      max_climb_m_s, max_descent_m_s: fastest change of height.
      max_turn_deg: sharpest change of heading at one waypoint without slowing down.
      speed_m_s: along the route, in cruise.
      power_w: mean electrical power in flight.

    Raises:
      InputError: a value that is not a positive number, a turn above 180 degrees, or a power without a speed.

    Examples:
      >>> constraints = ju.Constraints.read(vehicle=ju.Vehicle(speed_m_s=10.0))
      >>> planned = ju.plan(maps, start, goal, altitude_m=60.0, constraints=constraints)
      >>> planned.settings["limits"]["vehicle_speed_m_s"]
      10.0
    """

    max_climb_m_s: float | None = None
    max_descent_m_s: float | None = None
    max_turn_deg: float | None = None
    speed_m_s: float | None = None
    power_w: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers, and make them floats."""
        for limit in fields(self):
            value = getattr(self, limit.name)
            if value is not None:
                object.__setattr__(self, limit.name, positive(limit.name, value))
        if self.max_turn_deg is not None and self.max_turn_deg > FULL_TURN_DEG:
            raise InputError(
                f"max_turn_deg must be at most {FULL_TURN_DEG:g} degrees, got {self.max_turn_deg:g}"
            )
        if self.power_w is not None and self.speed_m_s is None:
            raise InputError(
                "power_w gives an energy only over a time: give the speed too, speed_m_s (--report)"
            )

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> "Vehicle":
        """Return the vehicle that a path was planned for, from its ``settings``.

        Returns:
          The vehicle: what the settings leave out is as in ``Vehicle()``.

        Examples:
          >>> ju.Vehicle.of({"limits": {"vehicle_speed_m_s": 10.0}}).speed_m_s
          10.0
          >>> ju.Vehicle.of(path.settings) == ju.Vehicle()  # path was planned for none
          True
        """
        limits = settings.get("limits", {})
        names = [item.name for item in fields(cls)]
        return cls(**{name: limits[PREFIX + name] for name in names if PREFIX + name in limits})

    def to_dict(self) -> dict[str, float]:
        """Return the vehicle as plain values; empty where nothing is known of it.

        Returns:
          The values by name, in the units of the attributes.

        Examples:
          >>> ju.Vehicle(speed_m_s=10.0).to_dict()
          {'vehicle_speed_m_s': 10.0}
        """
        named = {item.name: getattr(self, item.name) for item in fields(self)}
        return {PREFIX + name: float(value) for name, value in named.items() if value}

    def flight_s(self, air_m: "np.ndarray", rise_m: "np.ndarray", speed_m_s: float) -> "np.ndarray":
        """Return the seconds that straight parts of a route take; without a limit, heights change at any speed.

        Args:
          air_m: ``[M]`` their lengths in the air.
          rise_m: ``[M]`` how much higher each ends than it begins.
          speed_m_s: along the route.

        Returns:
          The seconds, ``[M]`` float64: of each part the longest of cruise, climb and descent.

        Examples:
          >>> vehicle = ju.Vehicle(max_climb_m_s=2.0)
          >>> vehicle.flight_s(np.array([100.0, 100.0]), np.array([0.0, 40.0]), 10.0).tolist()
          [10.0, 20.0]
        """
        import numpy as np  # here: the settings of commands are read without it

        cruise_s = air_m / speed_m_s
        # The seconds of a climb are below 0 in a descent, and those of a descent in a climb.
        climb_s = rise_m / (self.max_climb_m_s or math.inf)
        descent_s = -rise_m / (self.max_descent_m_s or math.inf)
        return np.maximum(cruise_s, np.maximum(climb_s, descent_s))
