"""Scenario: the validated settings of one job, to and from TOML."""

import json
import math
import operator
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, cast, get_args

import tomli_w
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetPydanticSchema,
    PlainSerializer,
    PrivateAttr,
    ValidationError,
    model_validator,
)

from jaxurban import wings
from jaxurban.checks import (
    at_least,
    check_metres,
    check_size,
    different_lengths,
    nearest_name,
    positive,
    typed,
    values_given,
)
from jaxurban.errors import GuessWarning, InputError, readable, speaking, warn
from jaxurban.io.samples import filled, is_sample, located
from jaxurban.maps.params import MapParams
from jaxurban.metrics.custom import Layer, check_layers
from jaxurban.metrics.gps import Dop, Gps
from jaxurban.metrics.gps_floor import GpsFloor
from jaxurban.metrics.lidar import Lidar
from jaxurban.metrics.population import Population
from jaxurban.metrics.protection import Protection
from jaxurban.metrics.registry import METRICS, ON_REQUEST, known_metrics
from jaxurban.metrics.risk import Risk
from jaxurban.metrics.weights import Weights
from jaxurban.settings import (
    Backend,
    Buildings,
    PlannerName,
    Planning,
    Terrain,
    Vegetation,
    Vehicle,
    as_tuple,
    iso_utc,
)
from jaxurban.world.grid import Bounds, check_bounds, projected_crs
from jaxurban.world.kinds import KindName, Obstacles

SYNTHETIC = "synthetic"
MOST_INSTANCES = 1_000_000
# Of a region most of which is empty and that nobody asked for: 35 x 35 km of 5 m.
MOST_EMPTY_CELLS = 50_000_000
PAPER_PLANNERS: tuple[PlannerName, ...] = (
    "ptp",
    "astar-dist",
    "astar-plus",
    "bitstar-dist",
    "bitstar-plus",
)
REMEDY = 'give sections and their keys, and write "/" or \'...\' for "\\" in double quotes'
UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
WeightTable = Annotated[  # weights by name; `Scenario` knows which names there are
    dict[str, Any],
    AfterValidator(lambda named: Weights(**named).checked()),
    PlainSerializer(Weights.to_dict),
]
WeightSettings = Annotated[
    Weights, GetPydanticSchema(lambda _, handler: handler.generate_schema(WeightTable))
]


OneOrMore = Annotated[tuple[float, ...], BeforeValidator(as_tuple)]  # a TOML may name one alone


@typed
@dataclass(frozen=True)
class Region:
    """Where, how fine and how high maps are made.

    Attributes:
      bounds: west, south, east, north in degrees.
      crs: projected, in metres; left out, the UTM zone.
      resolution_m: sides of the cells; a set of maps for each.
      altitudes_m: flight altitudes above ground.
      oversample: n: occlusion and lidar on a surface n times finer.

    Raises:
      InputError: bounds that are no box, an unknown CRS, or a length that is not positive or is named twice.

    Examples:
      >>> region = ju.Region(bounds=(-74.02, 40.70, -73.98, 40.73), resolution_m=(5.0, 25.0))
      >>> ju.Scenario(region=region, buildings=ju.Buildings("synthetic")).region.altitudes_m
      (20.0, 60.0, 122.0, 600.0)
    """

    bounds: tuple[float, float, float, float]
    crs: str | None = None
    resolution_m: OneOrMore = (5.0,)
    altitudes_m: OneOrMore = (20.0, 60.0, 122.0, 600.0)
    oversample: int = 1

    def __post_init__(self) -> None:
        """Check the settings and write numbers as floats; errors as of the class."""
        object.__setattr__(self, "bounds", check_bounds(self.bounds))
        for name in ("resolution_m", "altitudes_m"):
            object.__setattr__(self, name, different_lengths(name, getattr(self, name)))
        object.__setattr__(self, "oversample", at_least("oversample", self.oversample, 1))
        if self.crs is not None:
            projected_crs(self.crs)


# Settings of a study that a table of instances has in itself.
OF_SAMPLING = ("instances", "altitudes_m", "weights", "land_cover")


@typed
@dataclass(frozen=True)
class Study:
    """A Monte Carlo study: its queries, and how every planner solves them.

    Attributes:
      instances: queries at each altitude.
      planners: each plans every instance.
      distance_only: planners that also plan the shortest path; its weighted cost is reported.
      altitudes_m: of the maps' altitudes; all if left out.
      land_cover: OSM file with water and parks; left out, the buildings' source where that is one.
      weights: ``"dirichlet"``, or weights that take turns (see `jaxurban.studies.sample_instances`).
      budget_s: seconds for each run.
      budget_iterations: instead, samples for planners that draw any, while the others run to their end: rows then
        repeat exactly, whatever the number of workers, but for ``elapsed_s``.
      seed: of the sampling of instances, and of sampling planners, mixed with the instance's number.
      backend: ``"jax"`` runs A* and BIT* in JAX if the budget is in seconds; all else is Numba. Rows say what ran.

    Raises:
      InputError: no planner, an unknown one, or a number that is too small.

    Examples:
      >>> study = ju.studies.Study(instances=20, planners="astar-plus", weights=[ju.Weights(risk=5.0)])
      >>> study.planners, study.distance_only
      (('astar-plus',), ('astar-dist',))
    """

    instances: int = 200
    planners: PlannerName | Sequence[PlannerName] = PAPER_PLANNERS
    distance_only: PlannerName | Sequence[PlannerName] = ("astar-dist",)
    altitudes_m: OneOrMore | None = None
    land_cover: str | None = None
    weights: tuple[WeightSettings, ...] | Literal["dirichlet"] = "dirichlet"
    budget_s: float = 2.0
    budget_iterations: int | None = None
    seed: int = 0
    backend: Backend = "auto"

    def __post_init__(self) -> None:
        """Check the settings, and write planners as tuples without repetitions; errors as of the class."""
        for name in ("planners", "distance_only"):
            planners = dict.fromkeys(as_tuple(getattr(self, name)))
            object.__setattr__(self, name, tuple(planners))
        if not self.planners:
            raise InputError("planners is empty: name at least one planner")
        if not self.weights:
            raise InputError("weights is empty: give 'dirichlet' or a list of weights by name")
        if self.altitudes_m is not None:
            object.__setattr__(
                self, "altitudes_m", different_lengths("altitudes_m", self.altitudes_m)
            )
        positive("budget_s", self.budget_s)
        at_least("instances", self.instances, 1)
        at_least("seed", self.seed, 0)
        if self.budget_iterations is not None:
            at_least("budget_iterations", self.budget_iterations, 1)
        if self.instances > MOST_INSTANCES:
            raise InputError(
                f"instances must be at most {MOST_INSTANCES:,} at each altitude, got {self.instances:,}"
            )


class Scenario(BaseModel):
    """All settings of one job, in the order of its TOML. Only ``region`` and ``buildings`` are needed.

    A subclass with a further field takes the section of a metric of one's own, by the metric's name.

    Attributes:
      region, buildings, terrain, vegetation, obstacles, weights, planning, vehicle, study: as their classes say.
      gps, lidar, population, risk: settings of the metrics of every cost.
      gps_horizontal, gps_vertical, protection: of metrics that are made where their settings or a weight is given.
      gps_floor: of the GPS floor, which is made where its settings are given.
      layers: cost layers of one's own, by name.

    Examples:
      >>> region = ju.Region(bounds=(-74.02, 40.70, -73.98, 40.73), resolution_m=(25.0,))
      >>> scenario = ju.Scenario(region=region, buildings=ju.Buildings("synthetic"))
      >>> scenario.region.altitudes_m, scenario.gps.mask_deg
      ((20.0, 60.0, 122.0, 600.0), 5.0)
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    region: Region
    buildings: Buildings
    terrain: Terrain = Terrain()
    vegetation: Vegetation = Vegetation()
    obstacles: Obstacles = Obstacles()
    gps: Gps = Gps()
    lidar: Lidar = Lidar()
    population: Population = Population()
    risk: Risk = Risk()
    gps_horizontal: Dop | None = Field(default=None, exclude_if=operator.not_)
    gps_vertical: Dop | None = Field(default=None, exclude_if=operator.not_)
    protection: Protection | None = Field(default=None, exclude_if=operator.not_)
    gps_floor: GpsFloor | None = Field(default=None, exclude_if=operator.not_)
    layers: dict[str, Layer] = Field(default_factory=dict, exclude_if=operator.not_)
    weights: WeightSettings = Field(default_factory=Weights)
    planning: Planning = Planning()
    vehicle: Vehicle = Vehicle()
    study: Study = Study()
    _folder: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _check(self) -> "Scenario":
        """Return the scenario, with metrics on request added that have a weight.

        Raises:
          ValueError: bad layers or weights, or settings of several sections that contradict each
            other. Pydantic names the scenario's sections in its error.
        """
        self._check_layers()
        self._request_what_is_weighed()
        people = self.map_params.population  # `MapParams` checks the settings of maps together
        has_files = people.blocks or people.blocks_day or self.terrain.source
        if self.is_synthetic and has_files:
            raise ValueError(
                "the synthetic city (source = 'synthetic') has its own population and flat ground: leave out "
                "[population] blocks and [terrain] source, or name a source of real buildings"
            )
        return self

    @property
    def _weight_tables(self) -> dict[str, Weights]:
        """All weights of the scenario by their dotted key: ``weights``, and ``study.weights.0`` and so on."""
        tables = {"weights": self.weights}
        if not isinstance(self.study.weights, str):
            for number, table in enumerate(self.study.weights):
                tables[f"study.weights.{number}"] = table
        return tables

    def _check_layers(self) -> None:
        """Check layers and weights.

        Raises:
          ValueError: a layer that is not a file, or a weight of an unknown metric or of an invalid value.
        """
        for name, layer in check_layers(self.layers).items():
            if not isinstance(layer.source, str):
                raise ValueError(
                    f"layers.{name}: source must be the path of a raster, got {layer.source!r}"
                )
        built_in = [metric.name for metric in known_metrics().values() if metric.is_cost]
        metrics = [*self.layers, *built_in]
        for where, table in self._weight_tables.items():
            try:
                table.checked(metrics)
            except InputError as error:
                raise ValueError(f"{where}: {error}") from error

    @classmethod
    @speaking("scenario")
    @typed
    def from_toml(cls, path: str | Path, changes: Sequence[str] = ()) -> "Scenario":
        """Return the scenario in a TOML file; relative paths in it are relative to the file.

        Args:
          path: of the file; or the name of a sample city, as ``sample:shinjuku``, for its own settings.
          changes: of its settings, as ``"gps.mask_deg=10"``: a dotted key and a value as TOML writes it.

        Returns:
          The scenario, its defaults filled in.

        Raises:
          InputError: no such file, not TOML, an unknown key (names near ones) or a bad value.

        Examples:
          >>> scenario = ju.Scenario.from_toml("sample:shinjuku", changes=["gps.mask_deg=10"])
          >>> scenario.region.bounds, scenario.gps.mask_deg
          ((139.689, 35.6806, 139.7111, 35.6986), 10.0)
        """
        if is_sample(path):
            settings = changed({"buildings": {"source": str(path)}}, changes)
            return cls.from_dict(settings, name=str(path))
        path = Path(path)
        # Everything is within the block, as tables nested without end fail only where their settings are used.
        with readable(path, "a scenario in TOML", REMEDY):
            settings = changed(tomllib.loads(path.read_text(encoding="utf-8-sig")), changes)
            options = [f"--set {change}" for change in changes]
            name = " ".join([str(path), *options])
            return cls.from_dict(settings, name=name, folder=path.resolve().parent)

    @classmethod
    @speaking("scenario")
    @typed
    def from_dict(
        cls, settings: dict[str, Any], name: str = "the scenario", folder: Path | None = None
    ) -> "Scenario":
        """Return the scenario in nested dicts, sections by name.

        Args:
          settings: the sections, each a dict of its settings.
          name: what messages call the scenario.
          folder: that relative paths are relative to; left out, the current one.

        Returns:
          The scenario, its defaults filled in.

        Raises:
          InputError: an unknown key (names the nearest one), a missing one or a bad value.

        Examples:
          >>> region = {"bounds": [-74.02, 40.70, -73.98, 40.73]}
          >>> scenario = ju.Scenario.from_dict({"region": region, "buildings": {"source": "synthetic"}})
          >>> scenario.planning.planner
          'astar'
        """
        folder = Path(folder or "")
        located_files = _with_support(filled(settings), folder)
        with_bounds, extent = _with_bounds(located_files, folder)
        _check_sizes(with_bounds, f"{name}: ")
        try:
            # As JSON: of that pydantic takes lists for tuples, and nothing else for what it is not.
            scenario = cls.model_validate_json(json.dumps(with_bounds, default=_plain), strict=True)
        except ValidationError as error:
            raise InputError(f"{name}: {_sentence_of(error, settings, cls)}") from error
        scenario._folder = folder
        if extent is not None:
            _check_extent(scenario, extent)
        return scenario

    def to_toml(self) -> str:
        """Return the scenario as TOML: every setting, but those that are None and left to the preset.

        Returns:
          The text; `from_toml` reads a file of it as the same scenario.

        Examples:
          >>> text = ju.Scenario.from_toml("sample:shinjuku").to_toml()
          >>> "mask_deg = 5.0" in text
          True
        """
        return tomli_w.dumps(self.model_dump(exclude_none=True))

    def path_of(self, name: str | Path) -> Path:
        """Return the path that a setting names; a relative path is taken from the scenario's folder.

        The name of a sample city's file is returned unchanged: `jaxurban.io.samples.located` says where it lies.

        Returns:
          The path, relative to the current folder where the scenario has no folder of its own.

        Examples:
          >>> from pathlib import Path
          >>> region = {"bounds": [-74.02, 40.70, -73.98, 40.73]}
          >>> settings = {"region": region, "buildings": {"source": "synthetic"}}
          >>> ju.Scenario.from_dict(settings, folder=Path("towns")).path_of("blocks.gpkg").as_posix()
          'towns/blocks.gpkg'
        """
        return Path(name) if is_sample(name) else self._folder / name

    def _request_what_is_weighed(self) -> None:
        """Add a section of defaults, in place, for each metric on request that has a weight above 0 and no section."""
        for metric in known_metrics().values():
            tables = self._weight_tables.values()
            is_weighed = any(table.to_dict().get(metric.name) for table in tables)
            is_on_request = metric.section in ON_REQUEST
            if is_on_request and is_weighed and getattr(self, metric.section) is None:
                object.__setattr__(self, metric.section, metric.params())

    @property
    def map_params(self) -> MapParams:
        """What the maps depend on besides city, sky and grid."""
        region = self.region
        sections = {name: getattr(self, name, None) for name in (*METRICS, *ON_REQUEST)}
        return MapParams(
            region.altitudes_m,
            region.oversample,
            heights=self.buildings,
            sections=values_given(sections),
        )

    @property
    def kinds(self) -> tuple[KindName, ...]:
        """The kinds of what stands that count."""
        return self.obstacles.under(self.planning.preset)

    @property
    def is_synthetic(self) -> bool:
        """Whether the source is the synthetic city."""
        return self.buildings.source == SYNTHETIC


def _with_support(settings: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """Return settings in which the file of ``[protection] isd``, if one is named, is a path from the current folder."""
    match settings:
        case {"protection": {"isd": str(file), **limits}}:
            return {**settings, "protection": {**limits, "isd": str(folder / file)}}
    return settings


def _with_bounds(
    settings: Mapping[str, Any], folder: Path
) -> tuple[Mapping[str, Any], Bounds | None]:
    """Return settings with bounds: where they give none, those of what the file of buildings covers.

    Args:
      settings: by section; not necessarily valid.
      folder: that the file's path is relative to.

    Returns:
      The settings, and the bounds that were added (west, south, east, north in degrees); None in their place where the
      settings have bounds, or where no file of buildings is named.
    """
    match {"region": {}, **settings}:
        case {"region": {"bounds": _}}:
            pass
        case {"region": {**region}, "buildings": {"source": str(source)}} if source != SYNTHETIC:
            path = located(source) if is_sample(source) else folder / source
            extent = wings.lonlat_extent(path, settings["buildings"].get("crs"))
            return {**settings, "region": {**region, "bounds": extent}}, extent
    return settings, None


def _check_extent(scenario: Scenario, extent: Bounds) -> None:
    """Warn where bounds that were left out make a region far larger than the box that holds most buildings.

    Args:
      scenario: with the bounds of all buildings.
      extent: what the file covers: west, south, east, north in degrees.

    Raises:
      InputError: such a region has more than `MOST_EMPTY_CELLS`.
    """
    region, file = scenario.region, scenario.buildings
    located_file = replace(file, source=scenario.path_of(file.source))
    main = wings.proposed_bounds(located_file, extent, region.crs)
    if main is None:
        return
    sentence = wings.covers_too_much(file.source, extent, main)
    side_m = min(region.resolution_m)
    num_cells = math.prod(wings.size_m(region.bounds)) / side_m**2
    if num_cells > MOST_EMPTY_CELLS:
        bounds = [round(value, 6) for value in region.bounds]
        raise InputError(
            f"{sentence}; give these in [region] (all of it is {num_cells / 1e6:,.0f} million cells of "
            f"{side_m:g} m: bounds = {bounds})"
        )
    warn(sentence, GuessWarning)


def changed(settings: dict[str, Any], changes: Iterable[str]) -> dict[str, Any]:
    """Return settings with changes, of which a later one goes over an earlier one.

    Args:
      settings: nested, as TOML reads them.
      changes: each is ``key=value``: a dotted key of the scenario, and a value as TOML writes it.

    Raises:
      InputError: no ``=``, or a value that is not TOML.
    """
    for change in changes:
        key, equals, value = change.partition("=")
        if not equals:
            raise InputError(f"--set {change!r} must be key=value, as in gps.mask_deg=10")
        try:
            change_alone = tomllib.loads(f"{key} = {value}")
        except tomllib.TOMLDecodeError as error:
            raise InputError(
                f"--set {change!r} is not TOML ({error}): write texts in quotes, as in "
                "buildings.source='\"town.osm\"', and lists in brackets, as in region.altitudes_m=[20,60]"
            ) from error
        settings = _merged(settings, change_alone)
    return settings


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """Return old settings with new ones over them, table by table at every depth."""
    merged = {**old, **new}
    for name, value in new.items():
        if isinstance(value, Mapping) and isinstance(old.get(name), Mapping):
            merged[name] = _merged(old[name], value)
    return merged


def _sentence_of(error: ValidationError, settings: Any, model: type) -> str:
    """Return one error that pydantic has of settings as a sentence that names the setting: first what is unknown.

    A section or a key that is mistyped is missing under its right name too.

    Args:
      error: from the validation.
      settings: that were validated, nested.
      model: of the settings.
    """
    first = min(error.errors(), key=lambda fault: fault["type"] not in UNKNOWN)
    *parents, last = first["loc"] or ("",)

    # The dotted key of the setting. Parts that the settings do not hold are pydantic's names for types of a union.
    names = []
    for part in parents:
        model = model_in(fields_of(model).get(str(part))) or model
        if _holds(settings, part):
            settings = settings[part]
            names.append(str(part))
    if first["type"] == "missing" or _holds(settings, last):
        names.append(str(last))
    key = ".".join(names)

    # The sentence, by the type of error.
    if first["type"] in UNKNOWN:
        valid = list(fields_of(model))
        hint = nearest_name(str(last), valid) or f"; the valid ones are {', '.join(valid)}"
        return f"unknown {'key' if parents else 'section'} {key!r}{hint}"
    if first["type"] == "missing":
        return f"{key!r} is required and missing"
    message = first["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    if first["type"] != "value_error":
        message += f", got {first['input']!r}"
    return f"{key}: {message}" if key else message


def _check_sizes(settings: Mapping[str, Any], where: str) -> None:
    """Raise InputError where a number in nested settings is out of range, or a length is a text with its unit.

    Args:
      settings: the settings.
      where: stands before a name.
    """
    for name, value in settings.items():
        if isinstance(value, Mapping):
            _check_sizes(value, f"{where}{name}: ")
        else:
            check_size(f"{where}{name}", value)
            check_metres(f"{where}{name}", value)


def _plain(value: Any) -> str:
    """Return a value of TOML or Python that JSON lacks as a text: times as ISO 8601, paths as they are."""
    return iso_utc(value) if isinstance(value, datetime) else str(value)


def fields_of(model: type) -> dict[str, Any]:
    """Return the annotation of each field of a pydantic model or a dataclass, by name."""
    if issubclass(model, BaseModel):
        return {name: field.annotation for name, field in model.model_fields.items()}
    return {field.name: field.type for field in fields(cast(Any, model))}


def _holds(settings: Any, part: str | int) -> bool:
    """Return whether settings have a key, where they are a mapping, or an index, where they are a list."""
    if isinstance(part, int):
        return isinstance(settings, list | tuple) and part < len(settings)
    return isinstance(settings, Mapping) and part in settings


def model_in(annotation: Any) -> type | None:
    """Return the first model or dataclass in an annotation: itself, or in a list or union; None without one."""
    if isinstance(annotation, type) and (
        issubclass(annotation, BaseModel) or is_dataclass(annotation)
    ):
        return annotation
    return next(filter(None, map(model_in, get_args(annotation))), None)
