"""Scenario: the validated settings of one job, to and from TOML."""

import tomllib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    model_validator,
)

from jaxurban.cost import MOST_WEIGHT
from jaxurban.errors import InputError
from jaxurban.faults import sentence_of
from jaxurban.grid import check_bounds, projected_crs
from jaxurban.io.orbits import iso_utc
from jaxurban.metrics.gps import GpsParams
from jaxurban.metrics.lidar import LidarParams
from jaxurban.metrics.population import PopulationParams, day_share
from jaxurban.metrics.risk import RiskParams
from jaxurban.planners.registry import find_planner

SYNTHETIC = "synthetic"
MOST_EPOCHS = 100_000  # a year in steps of five minutes
PAPER_TIME = datetime(2020, 4, 27, 16, tzinfo=UTC)  # when no time is given
NOMINAL = "nominal"
PAPER_PLANNERS = ("ptp", "astar-dist", "astar-plus", "bitstar-dist", "bitstar-plus")

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
PositiveInt = Annotated[int, Field(gt=0)]


def _not_too_heavy(weight: float) -> float:
    if weight > MOST_WEIGHT:
        raise ValueError(f"a weight must be at most {MOST_WEIGHT:g}, got {weight:g}")
    return weight


Weight = Annotated[NonNegative, AfterValidator(_not_too_heavy)]


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


def _known_planner(name: str) -> str:
    find_planner(name)
    return name


PlannerName = Annotated[str, AfterValidator(_known_planner)]


def _as_utc(time: datetime) -> datetime:
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


Utc = Annotated[datetime, AfterValidator(_as_utc)]  # a naive time is UTC already
Seed = Annotated[int, Field(ge=0)]
StrList = Annotated[tuple[str, ...], BeforeValidator(_as_list), Field(min_length=1)]
PositiveList = Annotated[tuple[Positive, ...], BeforeValidator(_as_list), Field(min_length=1)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _no_truth_for_a_number(cls, values: Any) -> Any:
        for name, value in values.items() if isinstance(values, dict) else ():
            if isinstance(value, bool) and name in cls.model_fields and cls.model_fields[name].annotation is not bool:
                raise ValueError(f"{name} cannot be {str(value).lower()}: give a number, a text or a list")
        return values


class Region(_Section):
    """Where, how fine and how high."""

    bounds: tuple[float, float, float, float]
    crs: str | None = None
    resolution_m: PositiveList = (5.0,)
    altitudes_m: PositiveList = (20.0, 60.0, 122.0, 600.0)
    oversample: PositiveInt = 1

    @model_validator(mode="after")
    def _check(self) -> "Region":
        check_bounds(self.bounds)
        if self.crs is not None:
            projected_crs(self.crs)
        for name in ("resolution_m", "altitudes_m"):
            values = getattr(self, name)
            if len({f"{value:g}" for value in values}) != len(values):
                raise ValueError(f"{name} names a value twice (file names carry six digits)")
        return self


class HeightStdSettings(_Section):
    """Standard deviation of heights by their origin, metres (`jaxurban.uncertainty.HeightStd` says why these)."""

    height: NonNegative = 1.0
    levels: NonNegative = 3.0
    default: NonNegative = 5.0
    raster: NonNegative = 1.0


class BuildingSettings(_Section):
    """Where buildings come from, what stands in for missing heights, and how well heights are known."""

    source: str
    kind: Literal["height", "surface"] = "height"  # of a raster: above ground, or a surface model, above sea level
    default_height_m: Positive = 10.0
    level_height_m: Positive = 3.0
    all_touched: bool = False
    allow_none: bool = False
    height_std_m: HeightStdSettings = HeightStdSettings()
    height_samples: Annotated[int, Field(ge=0)] = 0  # of the spread maps; 0: none are made
    height_seed: Seed = 0

    @model_validator(mode="after")
    def _check(self) -> "BuildingSettings":
        if self.height_samples == 1:
            raise ValueError("height_samples is 1: a spread needs at least 2 samples (0 makes none)")
        return self


class TerrainSettings(_Section):
    """Ground elevation; left out: flat."""

    source: str | None = None


class GpsSettings(_Section):
    """Satellites, epochs and the DOP threshold."""

    orbits: StrList = (NOMINAL,)
    times: tuple[Utc, ...] | None = None
    start: Utc | None = None
    stop: Utc | None = None
    step_s: PositiveInt | None = None
    mask_deg: Annotated[float, Field(ge=0, lt=90)] = 5.0
    gdop_threshold: Annotated[float, Field(gt=1, allow_inf_nan=False)] = 20.0
    max_age_days: Positive = 90.0
    reference: tuple[float, float] | None = None
    series: Literal["auto", "epochs", "statistics"] = "auto"
    availability_threshold: Annotated[float, Field(ge=0, lt=1)] = 0.5
    bounds: bool = False  # also make gps_lower and gps_upper

    @model_validator(mode="after")
    def _check(self) -> "GpsSettings":
        series = (self.start, self.stop, self.step_s)
        if any(value is not None for value in series):
            if any(value is None for value in series):
                raise ValueError("a series of epochs needs all of start, stop and step_s")
            if self.times is not None:
                raise ValueError("give either times or start, stop and step_s, not both")
            if self.start and self.stop and self.step_s:
                count = (self.stop - self.start).total_seconds() / self.step_s + 1
                if count > MOST_EPOCHS:
                    raise ValueError(f"start, stop and step_s make {count:.3g} epochs: make step_s longer")
            if self.start and self.stop and self.stop < self.start:
                raise ValueError("stop is before start")
        if self.times is not None and not self.times:
            raise ValueError("times is empty: give at least one UTC time such as 2020-04-27T16:00:00Z")
        if len(set(self.epochs)) != len(self.epochs):
            raise ValueError("the epochs name a time twice")
        if not all(len(epoch) == len("2020-04-27T16:00:00Z") for epoch in self.epochs):
            raise ValueError("epochs must be whole seconds, as file names carry them")
        if self.reference is not None and not (abs(self.reference[0]) <= 180 and abs(self.reference[1]) <= 90):
            raise ValueError("reference is longitude, latitude in degrees")
        return self

    @property
    def epochs(self) -> tuple[str, ...]:
        """The UTC epochs, ISO 8601 with a trailing Z."""
        if self.start is not None and self.stop is not None and self.step_s is not None:
            count = int((self.stop - self.start).total_seconds() // self.step_s) + 1
            times = [self.start + timedelta(seconds=self.step_s * i) for i in range(count)]
        else:
            times = list(self.times or (PAPER_TIME,))
        return tuple(iso_utc(time) for time in times)


class LidarSettings(_Section):
    """The scanner."""

    beams: PositiveInt = 16
    field_of_view_deg: tuple[float, float] = (-15.0, 15.0)
    azimuths: PositiveInt = 360
    range_m: Positive = 100.0

    @model_validator(mode="after")
    def _check(self) -> "LidarSettings":
        self.params()
        return self

    def params(self) -> LidarParams:
        """Return the lidar metric's parameters."""
        return LidarParams(self.beams, self.field_of_view_deg, self.azimuths, self.range_m)


class PopulationSettings(_Section):
    """Census blocks, districts, and how day differs from night."""

    blocks: str | None = None
    block_field: str = "GEOID10"
    table: str | None = None
    districts: str | None = None
    district_field: str = "BoroCD"
    commercial: tuple[int, ...] = (101, 102, 103, 104, 105, 106)
    gamma_commercial: NonNegative = 3.0
    gamma_residential: NonNegative = 0.5
    time_of_day: Annotated[tuple[str, ...], BeforeValidator(_as_list), Field(min_length=1)] = ("day", "night")
    quantity: Literal["density", "count"] = "density"
    normalise: str | float = "max"

    @model_validator(mode="after")
    def _check(self) -> "PopulationSettings":
        if self.blocks is None and (self.table is not None or self.districts is not None):
            raise ValueError("table and districts need blocks, the polygons of the census blocks")
        params = self.params()
        for time_of_day in self.time_of_day:
            day_share(time_of_day, params)
        if len(set(self.time_of_day)) != len(self.time_of_day):
            raise ValueError("time_of_day names a time twice")
        return self

    def params(self) -> PopulationParams:
        """Return the population metric's parameters."""
        return PopulationParams(
            gamma_commercial=self.gamma_commercial,
            gamma_residential=self.gamma_residential,
            quantity=self.quantity,
            normalise=self.normalise,
        )


class RiskSettings(_Section):
    """How near is dangerous."""

    threshold_m: Positive = 50.0
    distance: Literal["slice", "solid"] = "slice"

    def params(self) -> RiskParams:
        """Return the risk metric's parameters."""
        return RiskParams(self.threshold_m, self.distance)


class WeightSettings(_Section):
    """The weights of the cost."""

    distance: Weight = 0.1
    gps: Weight = 1.0
    lidar: Weight = 1.0
    population: Weight = 1.0
    risk: Weight = 1.0


class PlanningSettings(_Section):
    """How paths are sought."""

    planner: PlannerName = "astar-plus"
    obstacles: Literal["touched", "centre"] = "touched"
    cost_model: Literal["cell", "line"] = "cell"
    objective: Literal["weighted", "distance"] = "weighted"
    connectivity: Literal[4, 8] = 8
    diagonal: Literal["both-free", "always"] = "both-free"
    reference_length_m: Positive = 5.0
    budget_s: Positive = 180.0
    seed: Seed = 0


def _dirichlet_or_list(value: Any) -> Any:
    if value == "dirichlet" or (isinstance(value, list | tuple) and value):
        return value
    raise ValueError(f"must be 'dirichlet' or a list such as [{{ distance = 0.1, gps = 1.0 }}], got {value!r}")


class StudySettings(_Section):
    """A Monte Carlo study; planners are compared under the line model, which depends on no resolution."""

    instances: PositiveInt = 200
    planners: tuple[PlannerName, ...] = PAPER_PLANNERS
    distance_only: tuple[PlannerName, ...] = ("astar-dist",)  # run for the shortest path too
    altitudes_m: PositiveList | None = None
    land_cover: str | None = None  # OSM file with water and parks; left out, the buildings' source where that is one
    weights: Annotated[tuple[WeightSettings, ...] | Literal["dirichlet"], BeforeValidator(_dirichlet_or_list)] = (
        "dirichlet"
    )
    cost_model: Literal["cell", "line"] = "line"
    budget_s: Positive = 2.0
    budget_iterations: PositiveInt | None = None
    seed: Seed = 0

    @model_validator(mode="after")
    def _check(self) -> "StudySettings":
        if not self.planners:
            raise ValueError("planners is empty: name at least one planner")
        if self.altitudes_m is not None and len(set(self.altitudes_m)) != len(self.altitudes_m):
            raise ValueError("altitudes_m names a value twice")
        return self


class Scenario(_Section):
    """All settings of one job. Only ``region`` and ``buildings`` are required."""

    region: Region
    buildings: BuildingSettings
    terrain: TerrainSettings = TerrainSettings()
    gps: GpsSettings = GpsSettings()
    lidar: LidarSettings = LidarSettings()
    population: PopulationSettings = PopulationSettings()
    risk: RiskSettings = RiskSettings()
    weights: WeightSettings = WeightSettings()
    planning: PlanningSettings = PlanningSettings()
    study: StudySettings = StudySettings()
    _folder: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _check(self) -> "Scenario":
        if self.is_synthetic and (self.population.blocks or self.terrain.source):
            raise ValueError(
                "the embedded city (source = 'synthetic') has its own people and flat ground: leave out "
                "population.blocks and terrain.source, or name a source of real buildings"
            )
        keeps_epochs = GpsParams(series=self.gps.series).keeps_epochs(len(self.gps.epochs))
        if (self.gps.bounds or self.buildings.height_samples) and not keeps_epochs:
            raise ValueError(
                "[gps] bounds and [buildings] height_samples need the maps of every epoch: give fewer epochs, or set "
                "[gps] series = 'epochs'"
            )
        if self.gps.bounds and self.region.oversample % 2 == 0:
            raise ValueError(f"[gps] bounds need an odd [region] oversample, got {self.region.oversample}: use 3 or 5")
        return self

    @classmethod
    def from_toml(cls, path: str | Path) -> "Scenario":
        """Return the scenario in a TOML file; relative paths in it are relative to the file.

        Raises:
          InputError: no such file, not TOML, an unknown key (names the nearest one) or a bad value.
        """
        path = Path(path)
        try:
            settings = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(f"cannot read the scenario {str(path)!r}: {error.strerror or error}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{str(path)!r} is not a scenario in TOML: {error}") from error
        return cls.from_dict(settings, name=str(path), folder=path.resolve().parent)

    @classmethod
    def from_dict(cls, settings: dict[str, Any], name: str = "the scenario", folder: Path | None = None) -> "Scenario":
        """Return the scenario in nested dicts, sections by name; relative paths are relative to ``folder``.

        Raises:
          InputError: an unknown key (names the nearest one), a missing one or a bad value.
        """
        try:
            scenario = cls.model_validate(settings)
        except ValidationError as error:
            raise InputError(f"{name}: {sentence_of(error, cls)}") from error
        if folder is not None:
            scenario._folder = folder
        return scenario

    def to_toml(self) -> str:
        """Return the scenario as TOML, every setting written out."""
        return tomli_w.dumps(_without_none(self.model_dump(mode="python")))

    def path_of(self, name: str) -> Path:
        """Return the path that a setting names, relative ones taken from the scenario's folder."""
        return self._folder / name

    @property
    def is_synthetic(self) -> bool:
        """Whether the embedded city is asked for."""
        return self.buildings.source == SYNTHETIC


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, tuple | list):
        return [_without_none(item) for item in value]
    return value
