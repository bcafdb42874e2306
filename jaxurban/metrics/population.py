"""Population: how many people a flight is over, by day and by night."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, DTypeLike, Float, Int, Integer

from jaxurban.checks import nearest_name, typed
from jaxurban.errors import InputError
from jaxurban.metrics.base import (
    TIME_OF_DAY,
    AnyArray,
    Metric,
    Scale,
    Scene,
    SoftScene,
    Variable,
    high_is_bad,
)
from jaxurban.metrics.settings import check_fields, differentiable, is_known, is_not_negative
from jaxurban.programs import kept_jit
from jaxurban.settings import as_tuple
from jaxurban.world.blocks import Blocks, Zoning
from jaxurban.world.grid import Bounds
from jaxurban.world.surface import Surface

M2_PER_KM2 = 1e6
NORMS = ("pop_norm_per_km2", "pop_norm_per_block")  # attributes of maps, by time of day
PAPER_COMMERCIAL = (101, 102, 103, 104, 105, 106)  # of Manhattan's community districts
HOUR_OF_WEEK = re.compile(r"(weekday|weekend)-([01]\d|2[0-3])")

FILES = ("blocks", "table", "districts", "blocks_day", "blocks_night")
FACTORS = (
    *("gamma_commercial", "gamma_residential"),
    *("districts", "commercial", "blocks", "table", "column"),
)

# Share of the change from night to day that has happened at each hour, 0 to 23. Full from 9 to 17 (the paper's
# "9-to-5"); the linear ramps before and after are our assumption.
WEEKDAY_PROFILE = (0.0,) * 7 + (1 / 3, 2 / 3) + (1.0,) * 9 + (0.8, 0.6, 0.4, 0.2) + (0.0,) * 2
# Moss and Qing, The Dynamic Population of Manhattan (2012), as the paper quotes it: in millions 2.05 at night,
# 3.94 on a working day, 2.90 on a weekend day.
WEEKEND_SHARE = (2.90 - 2.05) / (3.94 - 2.05)
PROFILES = {
    "weekday": WEEKDAY_PROFILE,
    "weekend": tuple(WEEKEND_SHARE * share for share in WEEKDAY_PROFILE),
}


@differentiable("gamma_commercial", "gamma_residential")
@typed
@dataclass(frozen=True)
class Population:
    """Settings of the population metric. A pytree whose leaves are the gammas.

    Attributes:
      gamma_commercial: day population over night population in commercial districts, >= 0.
      gamma_residential: the same everywhere else, >= 0.
      quantity: ``"density"``, people per km2, or ``"count"``, people per block (the paper's literal wording).
      normalise: where m is 1: ``"max"``, the highest block of the region at that time of day (the paper);
        ``"p95"`` or another percentile of its inhabited blocks; or a number of people per km2 (per block
        under ``"count"``). Blocks above a percentile or a number get 1.
      blocks: census blocks, a vector file; or a raster of people without a table, each pixel of which is a block
        (WorldPop, GHSL, LandScan).
      block_field: field of the blocks file with one id a block.
      table: CSV of population with one header row or two (the second is words where the first names columns); its
        columns of ids and of counts are found by what they hold (`jaxurban.cities.census`). None: the count is a
        field of the blocks file.
      column: of the table, or of the blocks file without one, that holds the people; left out, known by its name.
      districts: district polygons, blocks take the one of largest overlap; left out, every block is in district 13.
      district_field: the districts' label, a whole number.
      blocks_day, blocks_night: instead of ``blocks``, two rasters of people as measured by day and by night, on grids
        of their own; none of `FACTORS` goes with them.
      credit: what the licence of these files asks for.
      commercial: labels of commercial districts; left out, 101 to 106 of New York's (``BoroCD``), else none.
      time_of_day: those that maps are made for, see `day_share`.

    Raises:
      InputError: a value out of its range, times of day that are not different, a table or districts without
        blocks, or one raster of day and night without the other or with settings that do not go with them.

    Examples:
      >>> people = ju.Population(gamma_commercial=2.0, time_of_day=("day", "weekday-18"))
      >>> made = ju.build_maps(city, grid=maps.grid, altitudes_m=(60.0,), population=people)
      >>> made.times_of_day, made.m("density", time_of_day="day").shape
      (('day', 'weekday-18'), (30, 30))
    """

    gamma_commercial: float = 3.0
    gamma_residential: float = 0.5
    quantity: Literal["density", "count"] = "density"
    normalise: str | float = "max"
    blocks: str | Path | None = None
    block_field: str = "GEOID10"
    table: str | Path | None = None
    districts: str | Path | None = None
    district_field: str = "BoroCD"
    blocks_day: str | Path | None = None
    blocks_night: str | Path | None = None
    credit: str = ""
    commercial: Sequence[int] | None = None
    time_of_day: str | Sequence[str] = ("day", "night")
    column: str | None = None

    def __post_init__(self) -> None:
        """Check the settings, and write labels and times of day, in place, as tuples; errors as of the class."""
        # The numbers: factors, and the percentile of the scale.
        gammas = "gamma_commercial", "gamma_residential"
        check_fields(self, gammas, "finite and not negative", is_not_negative)
        _percentile(self.normalise)  # raises InputError for an invalid one

        # Files that need polygons of blocks.
        needs_blocks = (self.table, self.districts, self.column) != (None, None, None)
        if needs_blocks and not self.has_blocks:
            raise InputError(
                "table, column and districts need blocks, the polygons of the census blocks"
            )

        # Labels of districts, and times of day.
        if self.commercial is not None:
            object.__setattr__(self, "commercial", tuple(self.commercial))
        object.__setattr__(self, "time_of_day", as_tuple(self.time_of_day))
        if not self.times_of_day or len(set(self.times_of_day)) < len(self.times_of_day):
            raise InputError(
                f"time_of_day must be different names such as day and night, got {[*self.time_of_day]}"
            )
        for time_of_day in self.times_of_day:
            day_share(time_of_day)  # raises InputError for an unknown one

        # Counts by day and by night, which stand in the place of blocks with factors.
        if (self.blocks_day is None) != (self.blocks_night is None):
            raise InputError("blocks_day and blocks_night go together: give both, or blocks alone")
        if self.blocks_day is not None:
            self.check_has_no_factor()

    def check_has_no_factor(self) -> None:
        """Check that no setting makes people by day of those by night, where both have been measured.

        Raises:
          InputError: one of `FACTORS` is not its default, or a time of day is neither day nor night.

        Examples:
          >>> try:
          ...     ju.Population(gamma_commercial=2.0).check_has_no_factor()
          ... except ju.InputError as error:
          ...     print(error)
          blocks_day and blocks_night go without factors: leave out gamma_commercial
        """
        named = []
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in FACTORS and is_known(value) and np.any(value != field.default):
                named.append(field.name)
        others = [name for name in self.times_of_day if name not in ("day", "night")]
        named += [f"time_of_day {name}" for name in others]
        if named:
            raise InputError(
                f"blocks_day and blocks_night go without factors: leave out {', '.join(named)}"
            )

    @property
    def has_blocks(self) -> bool:
        """Whether a file of people is named."""
        return self.blocks is not None or self.blocks_day is not None

    @property
    def times_of_day(self) -> tuple[str, ...]:
        """The times of day that maps are made for."""
        return tuple(self.time_of_day)

    @property
    def commercial_labels(self) -> tuple[int, ...]:
        """Labels of the districts that count as commercial.

        Where the settings name none, they are the paper's if the field of labels is New York's, ``BoroCD``
        (``boro_cd`` in some exports), else none.
        """
        if self.commercial is not None:
            return tuple(self.commercial)
        is_new_york = self.district_field.lower().replace("_", "") == "borocd"
        return PAPER_COMMERCIAL if is_new_york else ()


def check_has_people(params: Population | None, has_people: bool) -> None:
    """Check that settings of people are of a city that has any; the default settings say nothing.

    Raises:
      InputError: settings of people where none are known.
    """
    if has_people or params is None or params == Population():
        return
    raise InputError(
        "population has settings and the city has no people: name its blocks, as in City.from_files(...,"
        " population=Population(blocks=...)) or [population] blocks, or leave population out"
    )


LEAST_BLOCKS = 2**16  # for which the program of blocks is compiled, then powers of two


class BlockLayers(NamedTuple):
    """Population of every block, or of every cell. ``T`` times of day, ``N`` blocks (or ``y, x`` cells).

    Attributes:
      m: ``[T, N]`` float32 metric in [0, 1]; the cost c equals it.
      density_per_km2: ``[T, N]`` float32 people per km2.
      norm_per_km2: ``[T]`` float32 value at which m is 1 (people per block under ``quantity="count"``).
    """

    m: Any
    density_per_km2: Any
    norm_per_km2: Any


class BlockPopulation(NamedTuple):
    """Census blocks as arrays. ``N`` blocks, ``M`` of which set the norm.

    Attributes:
      night_count: ``[N]`` people by the census.
      area_m2: ``[N]`` area.
      zoning: ``[N]`` a `jaxurban.world.blocks.Zoning` each.
      in_region: ``[M]`` index of the blocks that touch the region.
      day_count: ``[N]`` people by day; None where factors make them of the night's.
    """

    night_count: Any
    area_m2: Any
    zoning: Any
    in_region: Any
    day_count: Any = None

    @classmethod
    def of(
        cls, blocks: Blocks, bounds_m: Bounds | None = None, dtype: DTypeLike = np.float32
    ) -> "BlockPopulation":
        """Return the people of a city's blocks as arrays of JAX.

        Args:
          blocks: the blocks.
          bounds_m: the region's box, x_min, y_min, x_max, y_max: the blocks that touch it set the norm; left out, all
            blocks do.
          dtype: of counts and areas: float32 or, where JAX has it enabled, float64.
        """
        people = cls(
            np.asarray(blocks.night_count, dtype),
            np.asarray(blocks.area_m2, dtype),
            blocks.zoning,
            region_blocks(blocks, bounds_m),
        )
        if blocks.day_count is not None:
            people = people._replace(day_count=np.asarray(blocks.day_count, dtype))
        return jax.device_put(people)


def _percentile(normalise: str | float) -> float | None:
    """Return the percentile that ``normalise`` names (100 for the maximum), None where it is a number.

    Raises:
      InputError: it is neither ``"max"``, a percentile such as ``"p95"`` nor a positive number.
    """
    if isinstance(normalise, str):
        if normalise == "max":
            return 100.0
        match = re.fullmatch(r"p(\d+(?:\.\d+)?)", normalise)
        if match and 0 < float(match[1]) <= 100:
            return float(match[1])
    elif np.isfinite(normalise) and normalise > 0:
        return None
    raise InputError(
        f"normalise must be 'max', a percentile such as 'p95', or a positive number per km2, got {normalise!r}"
    )


def day_share(time_of_day: str) -> float:
    """Return the share of the change from night to day that has happened: 0 is the night's population, 1 the day's.

    Args:
      time_of_day: ``"day"``, ``"night"``, or an hour of the week such as ``"weekday-08"`` or ``"weekend-14"``.

    Raises:
      InputError: no such time of day.
    """
    if time_of_day in ("day", "night"):
        return float(time_of_day == "day")
    match = HOUR_OF_WEEK.fullmatch(time_of_day)
    if match is None:
        hint = nearest_name(time_of_day, ("day", "night"))
        raise InputError(
            f"time_of_day must be 'day', 'night' or an hour such as 'weekday-08' or 'weekend-23', "
            f"got {time_of_day!r}{hint}"
        )
    return float(PROFILES[match[1]][int(match[2])])


def block_people(
    night_count: Float[Array, " N"],
    zoning: Integer[Array, " N"],
    share: Float[Array, ""] | float,
    gamma_commercial: Float[Array, ""] | float,
    gamma_residential: Float[Array, ""] | float,
) -> Float[Array, " N"]:
    """Return the people in each block: night count x (1 + share x (gamma - 1)).

    Share 0 is night and 1 is day, the two cases of the paper's equation (popgamma). Linear, so the
    gradient is exact in everything.

    Args:
      night_count: ``[N]`` people by the census.
      zoning: ``[N]`` a `Zoning` each; all but COMMERCIAL take ``gamma_residential``.
      share: from `day_share`.
      gamma_commercial: day over night population in commercial blocks.
      gamma_residential: the same everywhere else.
    """
    gamma = jnp.where(zoning == Zoning.COMMERCIAL, gamma_commercial, gamma_residential)
    return night_count * (1.0 + share * (gamma - 1.0))


def density_per_km2(people: Float[Array, " N"], area_m2: Float[Array, " N"]) -> Float[Array, " N"]:
    """Return ``[N]`` people per km2 of each block, 0 where its area is 0; its gradient is finite there too.

    Args:
      people: ``[N]`` in each block.
      area_m2: ``[N]`` of each block.
    """
    # The area of 1 m2 stands for 0, as a division by 0 would make the gradient NaN although it is not chosen.
    has_area = area_m2 > 0
    return jnp.where(has_area, people * M2_PER_KM2 / jnp.where(has_area, area_m2, 1.0), 0.0)


def normaliser(values: Float[Array, " N"], normalise: str | float) -> Float[Array, ""]:
    """Return the value at which m is 1, the paper's pop_norm; 0 where nobody lives.

    Percentiles are taken over inhabited blocks, or a city's empty ones (water, parks) would decide them.
    The gradient is that of the block (or two) that sets the value.

    Args:
      values: people, or people per km2, of the blocks of the region; may be empty.
      normalise: ``"max"``, a percentile such as ``"p95"``, or the value itself.
    """
    percentile = _percentile(normalise)
    if percentile is None:
        return jnp.asarray(normalise, values.dtype)
    if values.size == 0:
        return jnp.zeros((), values.dtype)
    if percentile == 100.0:
        return values.max()
    inhabited = jnp.where(values > 0, values, jnp.nan)
    return jnp.where(jnp.any(values > 0), jnp.nanpercentile(inhabited, percentile), 0.0)


def map_blocks(block: Int[AnyArray, "..."], values: Float[AnyArray, "*T N"]) -> Any:
    """Return the values of the block under each cell, ``[*T, *block.shape]``, 0 in cells without a block.

    NumPy's arrays give an array of NumPy, for which nothing is compiled.

    Args:
      block: number of the block under each cell, -1 without one.
      values: of each block.
    """
    xp: Any = np if isinstance(values, np.ndarray) else jnp
    only_last_axis = [(0, 0)] * (values.ndim - 1) + [(0, 1)]
    padded = xp.pad(values, only_last_axis)
    return padded[..., block]  # -1 is the last entry, the 0 added here


def block_values(
    blocks: BlockPopulation, share: Float[Array, ""] | float, params: Population
) -> tuple[Float[Array, " N"], Float[Array, " N"], Float[Array, ""]]:
    """Return m of each block at one time of day, its people per km2, and the value at which m is 1.

    Args:
      blocks: people, areas and zoning, and which of them set the norm.
      share: from `day_share`.
      params: gammas, quantity and norm.
    """
    if blocks.day_count is None:
        people = block_people(
            blocks.night_count,
            blocks.zoning,
            share,
            params.gamma_commercial,
            params.gamma_residential,
        )
    else:
        people = (1.0 - share) * blocks.night_count + share * blocks.day_count
    density = density_per_km2(people, blocks.area_m2)
    values = people if params.quantity == "count" else density
    norm = normaliser(values[blocks.in_region], params.normalise)
    # Equation (metric_pop), clipped to 1; 0 everywhere where the norm is 0. Where the clip acts the gradient is 0.
    m = jnp.minimum(values / jnp.where(norm > 0, norm, 1.0), 1.0)
    return m, density, norm


def region_blocks(blocks: Blocks, bounds_m: Bounds | None) -> Int[np.ndarray, " M"]:
    """Return the indices of the blocks that touch a box (x_min, y_min, x_max, y_max); of all blocks without a box."""
    return np.arange(len(blocks)) if bounds_m is None else np.flatnonzero(blocks.touches(bounds_m))


def block_layers(
    blocks: Blocks, params: Population | None = None, bounds_m: Bounds | None = None
) -> BlockLayers:
    """Return the metric and the density of every block at each time of day of the settings.

    Args:
      blocks: the census blocks.
      params: left out, the paper's.
      bounds_m: the region's box, to normalise by the blocks that touch it; left out, by all of them.
    """
    params = params or Population()
    population, shares = _made_ready(blocks, params, bounds_m)
    # Without the names of files, so that one program serves all of them.
    rules = Population(
        params.gamma_commercial, params.gamma_residential, params.quantity, params.normalise
    )
    m, density, norm = map(np.asarray, layers_of_blocks(_filled(population), shares, rules))
    return BlockLayers(m[:, : len(blocks)], density[:, : len(blocks)], norm)


def _filled(population: BlockPopulation) -> BlockPopulation:
    """Return blocks with empty ones behind them, which change no result, up to a power of two of at least 65,536.

    Programs are compiled for each number of blocks, so that few of them serve all cities.
    """
    num = len(population.night_count)
    rounded_num = max(LEAST_BLOCKS, 1 << num.bit_length())
    in_region = np.full(rounded_num, num, np.int32)  # number `num` is an empty block
    in_region[: len(population.in_region)] = population.in_region
    filled = jax.tree.map(lambda values: np.pad(values, (0, rounded_num - num)), population)
    return filled._replace(in_region=in_region)


def _made_ready(
    blocks: Blocks, params: Population, bounds_m: Bounds | None
) -> tuple[BlockPopulation, Float[np.ndarray, " D"]]:
    """Return the blocks as arrays, and `day_share` of each time of day of the settings.

    Args:
      blocks: the census blocks.
      params: the settings.
      bounds_m: the region's box, whose blocks set the norm; None for all blocks.

    Raises:
      InputError: blocks with measured people by day, and settings that would make these of the night's.
    """
    if blocks.day_count is not None:
        params.check_has_no_factor()
    shares = [day_share(time_of_day) for time_of_day in params.times_of_day]
    return BlockPopulation.of(blocks, bounds_m), np.array(shares, np.float32)


@kept_jit
def layers_of_blocks(
    blocks: BlockPopulation, shares: Float[Array, " T"], params: Population
) -> BlockLayers:
    """Return `block_values` at several times of day.

    They are computed one after the other and not together, so that the result of a time has the same bits whatever
    other times there are.
    """
    return BlockLayers(*lax.map(lambda share: block_values(blocks, share, params), shares))


def soft_population(
    block: Int[Array, "y x *samples"],
    population: BlockPopulation,
    time_of_day: str,
    params: Population,
    *,
    cells: Int[Array, "P 2"] | None = None,
) -> Float[Array, "y x"] | Float[Array, " P"]:
    """Return m_population at one time of day, on the region ``[y, x]`` or at chosen cells ``[P]``; no softness.

    The map is differentiable in both gammas and in ``population.night_count`` and ``area_m2``; batch it by `jax.vmap`.
    The gradient is exact. It includes the change of the norm with the block that sets it (or the two blocks of a
    percentile), and is 0 for a block above the norm. It is undefined where two blocks tie for the norm, and where a
    block lies just at it. Docs: algorithms/gradients.md.

    Args:
      block: index of the block under each cell, or under samples of it, -1 without one.
      population: from `BlockPopulation.of`.
      time_of_day: see `day_share`.
      params: gammas and norm.
      cells: row and column in the region; left out, the whole region.

    Raises:
      InputError: no such time of day.
    """
    m, _, _ = block_values(population, day_share(time_of_day), params)
    has_samples = block.ndim > 2
    if cells is not None:
        block = block[cells[:, 0], cells[:, 1]]
    return _over_samples(block, m, has_samples)


def _over_samples(block: AnyArray, values: AnyArray, has_samples: bool) -> Any:
    """Return the values of the block under each cell, or the mean over the blocks under the samples of each cell.

    Args:
      block: number of the block under each cell, -1 without one; with samples of a cell along the last axis.
      values: of each block.
      has_samples: whether that last axis is there.
    """
    if not has_samples:
        return map_blocks(block, values)
    num_samples = block.shape[-1]
    total: Any = sum(map_blocks(block[..., k], values) for k in range(num_samples))
    return total / values.dtype.type(num_samples)


def _on_cells(surface: Surface, layers: BlockLayers) -> dict[str, Any]:
    """Return the maps of blocks by their variable, ``[y, x]``, or ``[D, y, x]`` of layers at several times of day."""
    block = surface.block
    assert block is not None
    has_samples = block.ndim > 2
    return {
        "population": _over_samples(block, layers.m, has_samples),
        "density": _over_samples(block, layers.density_per_km2, has_samples),
    }


def _maps(scene: Scene, params: Population) -> dict[str, AnyArray]:
    """Return the maps of one time of day (`Metric.compute`)."""
    return _on_cells(scene.surface, scene.population)


def _ready(surface: Surface, _: Any, params: Population, blocks: Any) -> tuple:
    """Return the blocks and the shares of the times of day (`Metric.ready`)."""
    return _made_ready(blocks, params, surface.region.bounds_m)


def _traced(scene: Scene, params: Population) -> dict[str, Array]:
    """Return the maps of all times of day, of arrays that JAX may trace (`Metric.traced`)."""
    return _on_cells(scene.surface, layers_of_blocks(*scene.ready, params))


def _soft(scene: SoftScene, params: Population) -> Array:
    """Return m at one time of day with gradients (`Metric.soft`)."""
    assert scene.surface.block is not None
    return soft_population(
        scene.surface.block, scene.population, scene.time_of_day, params, cells=scene.cells
    )


def _attributes(params: Population) -> dict[str, str]:
    """Return what files say of the map: by density, what they say of it anyway; by count, another meaning of 1."""
    if params.quantity == "density":
        return {}
    return {"one_means": "as many people in the block as the norm (pop_norm_per_block)"}


DENSITY = Variable(
    "density",
    "people per square kilometre",
    "km-2",
    scale=Scale("magma_r", high=None, stretch="log", zero="no people, or no data of them"),
    title="People per km²",
)
METRIC = Metric(
    name="population",
    params=Population,
    dims=(TIME_OF_DAY,),
    compute=_maps,
    traced=_traced,
    ready=_ready,
    soft=_soft,
    cost=high_is_bad,
    label="Population",
    one_means="as many people per area as the norm (pop_norm_per_km2)",
    colour="#cc79a7",
    colour_map="magma_r",
    also=(DENSITY,),
    attributes=_attributes,
    sources=(*FILES, "block_field", "column", "district_field", "commercial", "credit"),
)
