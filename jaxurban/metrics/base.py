"""What a metric is: its parameters, its maps, its cost and how it is shown; and what it may look at."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from jaxurban.kernels.engine import Engine
from jaxurban.metrics.reception import ReceptionCurve
from jaxurban.world.grid import Grid
from jaxurban.world.surface import AnyArray as AnyArray
from jaxurban.world.surface import Surface

if TYPE_CHECKING:
    from jaxurban.metrics.visibility import SkyView
    from jaxurban.world.blocks import Blocks

ALTITUDE, TIME, TIME_OF_DAY = "altitude", "time", "time_of_day"
UNDERSIDE = "underside"  # of maps in which something hangs: its lowest floor above the ground, 0 where nothing does


def high_is_bad(m: AnyArray) -> AnyArray:
    """Return the cost c = m of a metric whose high values are to be avoided."""
    return m


def low_is_bad(m: AnyArray) -> AnyArray:
    """Return the cost c = 1 - m of a metric whose low values are to be avoided."""
    return 1.0 - m


COSTS = {"high-is-bad": high_is_bad, "low-is-bad": low_is_bad}


def none_of_it(*_: Any) -> float:
    """Return 0: a metric that costs nothing, looks at nothing beside its own cell, or keeps nothing beside on a GPU."""
    return 0.0


def no_attributes(params: Any) -> dict[str, str]:
    """Return nothing: a metric of which files say the same whatever its settings are."""
    return {}


class Scale(NamedTuple):
    """How the values of a variable become colours, in figures, in the viewer and in QGIS.

    Attributes:
      colour_map: of Matplotlib; perceptually uniform.
      low, high: values at its ends; None: the lowest or the highest of the maps.
      least: how far its ends are apart at least.
      limit: attribute of the maps whose value, twice, is the high end; "" for none.
      stretch: between the ends; ``"log"``: the last three decades up to the high end.
      is_better_low: whether low values are to be sought.
      zero: what 0 means where it is drawn apart, in white; "" where it is not.
    """

    colour_map: str = "cividis"
    low: float | None = 0.0
    high: float | None = 1.0
    least: float = 1.0
    limit: str = ""
    stretch: Literal["linear", "sqrt", "log"] = "linear"
    is_better_low: bool = False
    zero: str = ""

    def range(
        self, attrs: Mapping[str, Any], ends: Callable[[], tuple[float, float]]
    ) -> tuple[float, float]:
        """Return the value at the low end of the colours, and how far above it the high end is.

        Args:
          attrs: attributes of the maps.
          ends: returns the lowest and the highest value of the maps; it reads them, so it is called only if needed.
        """
        if self.limit:
            return 0.0, 2 * float(attrs[self.limit])
        low, high = self.low, self.high
        if low is None or high is None:
            lowest, highest = ends()
            low = lowest if low is None else low
            high = highest if high is None else high
        if self.stretch == "log" and high > 0:
            digit = 10.0 ** math.floor(math.log10(high))
            high = digit * math.ceil(high / digit)  # of one digit, and no less than any value
        return low, max(high - low, self.least)


@dataclass(frozen=True)
class Variable:
    """A map, and all that files, figures, the viewer and memory say of it.

    Attributes:
      name: of the variable.
      long_name: of files and of pictures.
      unit: of its values, as CF writes it; "" for none.
      dtype: of its values.
      inside: what it is inside obstacles, if it has an altitude: NaN where nothing is defined in there, 0 of satellites
        that nobody sees; None where it has values there as anywhere else.
      one_means: what a value of one means; "" where that needs no word.
      scale: how its values become colours.
      classes: name and colour of 0, of 1 and so on, of what is nothing else.
      symbol: short for it in pictures; "" for none.
      title: of its pictures; left out, its long name and the symbol (`heading`).
      dims: along which it varies beside y and x.
      of: the metric that makes it; "" for none. A metric gives name, dims and caveat to all of its variables.
      is_averaged: whether overviews may hold means of it, which of counts and of what may be infinite are neither.
      standard_name: of the CF conventions; "" for none.
      is_inf_missing: whether GeoTIFFs hold no value where it is infinite.
      caveat: what whoever reads it must know.
    """

    name: str
    long_name: str
    unit: str = "1"
    dtype: type = np.float32
    inside: float | None = None
    one_means: str = ""
    scale: Scale = field(default_factory=Scale)
    classes: tuple[tuple[str, str], ...] = ()
    symbol: str = ""
    title: str = ""
    dims: tuple[str, ...] = ()
    of: str = ""
    is_averaged: bool = True
    standard_name: str = ""
    is_inf_missing: bool = False
    caveat: str = ""

    @property
    def heading(self) -> str:
        """What pictures call it: its title, else its long name with a capital, and the symbol if it has one."""
        if self.title:
            return self.title
        long_name = self.long_name[0].upper() + self.long_name[1:]
        return f"{long_name} ({self.symbol})" if self.symbol else long_name


@dataclass(frozen=True, eq=False)
class Scene:
    """What a metric may look at for its maps of one tile, at one place along its dims. ``y, x`` cells of the tile.

    `Metric.traced` gets one of arrays that JAX traces, at all altitudes and times of day at once: ``altitude_m`` is
    ``[A]`` there, ``words`` ``[W, A, y, x]``, and of the others but the surface only the last two are given.

    Attributes:
      surface: roofs, terrain and census blocks on the tile (``surface.region``), roofs and terrain on the margin too
        (``surface.grid``), which holds every metric's reach; `Surface.crop` and `Surface.crop_with_halo` cut it. With
        slabs it is that of the altitude, if there is one (`Surface.at_altitude`).
      altitude_m: height above the ground; None for metrics without that dim.
      is_obstacle: ``[y, x]`` where the highest roof of the cell reaches the altitude, or a slab is; None without an
        altitude.
      supersampled: the same surface with cells ``oversample`` times smaller; None where they are the map's own.
      oversample: how many times finer that is.
      in_view: the satellites at or above the mask at the time (`jaxurban.world.sky.InView`); None for metrics without a
        time.
      words: ``[W, y, x]`` which of them each cell sees: satellite ``s`` is bit ``s % 32`` of word ``s // 32``.
      population: every census block at the time of day, ``[N]`` each and the norm
        (`jaxurban.metrics.population.BlockLayers`); None for metrics without one.
      rasters: ``[y, x]`` the values of a user's rasters at the altitude, by the name of their layer; NaN where
        they hold nothing.
      only_m: further variables are not looked at, and need not be made.
      engine: which form of its kernels runs (`jaxurban.kernels.engine`).
      shadows: ``[S, y, x]`` how high those of the satellites reach above the ground, for metrics of a time without an
        altitude.
      sky: the satellites of the time (`jaxurban.metrics.visibility.SkyView`), for traced metrics.
      ready: what `Metric.ready` has made on the host, for traced metrics.
    """

    surface: Surface
    altitude_m: Any = None
    is_obstacle: Any = None
    supersampled: Surface | None = None
    oversample: int = 1
    in_view: Any = None
    words: Any = None
    population: Any = None
    rasters: dict[str, np.ndarray] = field(default_factory=dict)
    only_m: bool = False
    engine: Engine = "auto"
    shadows: Any = None
    sky: Any = None
    ready: Any = None


class SoftScene(NamedTuple):
    """What a soft, differentiable metric may look at. ``P`` chosen cells.

    Attributes:
      surface: roofs and terrain, maybe traced.
      altitude_m: height above the ground, maybe traced.
      softness_m: see each metric; maybe traced.
      cells: ``[P, 2]`` row and column in the region; None for the whole region.
      reach_m: how far the metric looks at most; a plain number.
      view: the satellites.
      population: of the census blocks (`jaxurban.metrics.population.BlockPopulation`); None without population.
      time_of_day: of the population.
      reception: chance that a satellite is heard, in place of a softness; None for that.
    """

    surface: Surface
    altitude_m: Float[Array, ""] | float
    softness_m: Float[Array, ""] | float
    cells: Int[Array, "P 2"] | None
    reach_m: float
    view: "SkyView"
    population: Any
    time_of_day: str
    reception: ReceptionCurve | None = None


def on_scene(soft: Callable[..., Array], scene: SoftScene, params: Any) -> Array:
    """Return a soft metric of a scene, by a function that takes parts of the scene as arguments.

    Args:
      soft: function of surface, altitude, settings and softness, with the keywords ``cells`` and ``reach_m``.
      scene: what the metric may look at.
      params: settings of the metric.
    """
    return soft(
        scene.surface,
        scene.altitude_m,
        params,
        scene.softness_m,
        cells=scene.cells,
        reach_m=scene.reach_m,
    )


@dataclass(frozen=True, eq=False, repr=False)
class Metric:
    """One metric of the maps, from its equation to its colour. Functions are named ones, so that it can be pickled.

    Attributes:
      name: of its map and its weight.
      params: class of its settings.
      dims: along which its maps vary beside y and x: of ``"time"``, ``"altitude"``, ``"time_of_day"``, in this order.
      compute: returns the maps ``[y, x]`` of a scene by their variable: the metric m in [0, 1], float32, under
        ``name``, and those of ``also``. What they are inside obstacles, `Variable.inside` decides; NaN closes a cell.
      cost: turns m into the cost c in [0, 1] (numbers, NumPy or JAX arrays); `none_of_it` where no path pays for it.
      label: what figures call it.
      cost_label: what lists of weights and of costs call it: what the route avoids; left out, the label.
      one_means: what a value of one means.
      colour: of its lines in figures.
      colour_map: of its maps; perceptually uniform, each metric its own.
      unit: of its values.
      inside: what it is inside obstacles (see `Variable`).
      own: its own variable, where that is no m in [0, 1].
      reach_m: how far beyond a cell it looks sideways; satellites' shadows apart.
      traced: returns, of a traced scene, what ``compute`` returns place by place, each with its altitudes or times of
        day in front: a function of arrays alone; None where there is none.
      ready: returns what ``traced`` needs beside, made on the host of a surface, altitudes, settings, and the census
        blocks, if any; None where it needs nothing.
      soft: returns m of a soft scene, on its cells, with gradients; None where there is none.
      also: every further variable that ``compute`` returns.
      available: which of these, 0 or 1, says that a position is available, for its share of the times of a series;
        "" where that is m above a threshold.
      recorded: setting of each attribute that its maps have, by the attribute's name.
      attributes: returns what files say of its map under its settings, over what they say of its `Variable`.
      caveat: what every output of it says to whoever reads it.
      is_bracketed: whether one more satellite never makes it less, so that ``[gps] bounds`` can bracket it.
      is_numba_over_terrain: returns, of its settings, whether Numba makes it over terrain where the engine is
        ``"auto"``.
      terrain_bytes: returns what its form in JAX takes over terrain beside, of its settings and a tile.
      cell_bytes: what computing it holds at its highest, of each cell of a tile and of those within its reach; with a
        time, ``jaxurban.maps.memory`` adds what each altitude and each time of a series take.
      section: of the scenario, which holds its settings; left out, its name.
      sources: settings that say where and when its data are from, at which its maps do not look any more.
    """

    name: str
    params: type
    dims: tuple[str, ...]
    compute: Callable[[Scene, Any], Mapping[str, AnyArray]]
    cost: Callable[[Any], Any]
    label: str
    one_means: str
    colour: str
    colour_map: str
    cost_label: str = ""
    unit: str = "1"
    inside: float | None = np.nan
    own: Variable | None = None
    reach_m: Callable[[Any], float] = none_of_it
    traced: Callable[[Scene, Any], dict[str, Array]] | None = None
    ready: "Callable[[Surface, Sequence[float], Any, Blocks | None], Any] | None" = None
    soft: Callable[[SoftScene, Any], Array] | None = None
    also: tuple[Variable, ...] = ()
    available: str = ""
    recorded: Mapping[str, str] = field(default_factory=dict)
    attributes: Callable[[Any], dict[str, str]] = no_attributes
    caveat: str = ""
    is_bracketed: bool = False
    is_numba_over_terrain: Callable[[Any], bool] = lambda settings: False
    terrain_bytes: Callable[[Any, Grid], float] = none_of_it
    cell_bytes: int = 16
    section: str = ""
    sources: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Take the name for the section, and the label for that of the cost, where none is named."""
        object.__setattr__(self, "section", self.section or self.name)
        object.__setattr__(self, "cost_label", self.cost_label or self.label)

    def __repr__(self) -> str:
        return f"<{self.label}: 1 means {self.one_means}>"

    @property
    def variables(self) -> dict[str, Variable]:
        """Its own variable and all others that ``compute`` returns, by name."""
        own = self.own or Variable(
            self.name,
            self.label,
            self.unit,
            inside=self.inside,
            one_means=self.one_means,
            scale=Scale(self.colour_map),
        )
        return {
            variable.name: replace(variable, of=self.name, dims=self.dims, caveat=self.caveat)
            for variable in (own, *self.also)
        }

    @property
    def is_cost(self) -> bool:
        """Whether paths pay for it."""
        return self.cost is not none_of_it

    @property
    def one_is(self) -> str:
        """What a value of one is to a path, in a word."""
        return "worst" if self.cost is high_is_bad else "best"


def ones_said(metrics: Mapping[str, Metric]) -> str:
    """Return a sentence on what 1 means in the map of each metric."""
    said = (f"{name} is at its {each.one_is} ({each.one_means})" for name, each in metrics.items())
    return f"An m lies between 0 and 1. At 1 {', '.join(said)}."
