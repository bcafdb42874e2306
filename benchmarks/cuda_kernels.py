"""The JAX kernels that `make cuda-compile` compiles for a GPU, each with the shapes that it is called with.

A new kernel is one more line of `KERNELS`: its name, and a function that returns what to compile. Shapes are those of a
region of 8 M cells (5 m), or of a tile of 1 M cells where maps are made by tiles.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.kernels import dop
from jaxurban.kernels.blocks import LARGE, rounded_up
from jaxurban.kernels.distance import nearest as distance
from jaxurban.kernels.least_heights import least_heights
from jaxurban.kernels.lidar import hard
from jaxurban.kernels.lidar import soft as soft_lidar
from jaxurban.kernels.line.homeward import _highest_east
from jaxurban.kernels.line.segment_costs import segment_costs
from jaxurban.kernels.search import sample_graph, tiles
from jaxurban.kernels.shadows import blocks, rays, sweep
from jaxurban.kernels.shadows.sweep import shadow_heights
from jaxurban.kernels.soft_step import satellite_weights
from jaxurban.maps import at_once
from jaxurban.maps.differentiable import PathVisits, SoftCity, SoftParams
from jaxurban.metrics import gps, gps_soft, lidar, population, risk, visibility
from jaxurban.metrics.gps_floor import GpsFloor
from jaxurban.metrics.lidar import Lidar
from jaxurban.metrics.risk import Risk
from jaxurban.metrics.weights import Weights
from jaxurban.planners.bulk import EDGES_TOGETHER, NODES_TOGETHER
from jaxurban.planners.cost import STEPS
from jaxurban.planners.tile_search import TILES_TOGETHER
from jaxurban.studies.tuning import confidence, fenchel_young, target_fit
from jaxurban.studies.tuning.target import Target
from jaxurban.studies.weights import buildings
from jaxurban.world import surface
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface


class Call(NamedTuple):
    """What to compile.

    Attributes:
      function: made by `jax.jit`.
      arguments: arrays, or their shapes and types (`jax.ShapeDtypeStruct`).
      static: arguments by name that the program is compiled for.
      is_float64: it runs under ``jax.enable_x64(True)``.
    """

    function: Any
    arguments: tuple
    static: dict[str, Any] = {}  # noqa: RUF012
    is_float64: bool = False


def array(*shape: int, dtype: Any = jnp.float32) -> jax.ShapeDtypeStruct:
    """Return the shape and type of an array."""
    return jax.ShapeDtypeStruct(shape, dtype)


def float64(*shape: int) -> jax.ShapeDtypeStruct:
    return array(*shape, dtype=jnp.float64)


def int32(*shape: int) -> jax.ShapeDtypeStruct:
    return array(*shape, dtype=jnp.int32)


def gradient(of: Callable, by: int | tuple[int, ...] = 0) -> Any:
    """Return the compiled value and gradient of a function's sum."""
    return jax.jit(jax.value_and_grad(lambda *arguments: jnp.sum(of(*arguments)), by))


NUMBER, WHOLE = array(), int32()
REGION, MARGIN, TILE = (4000, 2000), 120, (1000, 1000)
SURFACE = tuple(side + 2 * MARGIN for side in REGION)
CELLS = int32(512, 2)  # of a path
HEIGHTS_M = array(512)
ALTITUDES_M = array(4)
NUM_SATELLITES = 9
ROUNDED = rounded_up(NUM_SATELLITES, sweep.TOGETHER)
AZIMUTH_RAD, ELEVATION_RAD = (
    np.linspace(0.3, 6.0, ROUNDED),
    np.linspace(0.3, 1.2, ROUNDED),
)


def line(shape: tuple[int, ...]) -> sweep.DigitalLine:
    return sweep.digital_line(AZIMUTH_RAD[0], ELEVATION_RAD[0], 5.0, 0, 0, shape)


def lines_over(shape: tuple[int, int], num: int = NUM_SATELLITES) -> sweep.DigitalLine:
    angles = AZIMUTH_RAD[:num], ELEVATION_RAD[:num]
    return sweep.stacked(sweep.digital_lines(*angles, 5.0, 0, 0, shape))


def lines() -> sweep.DigitalLine:
    return lines_over(SURFACE)


def satellites(num: int, multiple_of: int = 8, num_clocks: int = 1) -> dop.Geometry:
    rng = np.random.default_rng(0)
    directions = dop.unit_vectors(rng.uniform(0, 6, num), rng.uniform(0.1, 1.5, num))
    return dop.geometry(
        directions,
        multiple_of=multiple_of,
        clocks=dop.Clocks(np.arange(num) % num_clocks, num_clocks),
    )


BLOCK, GROWN = (LARGE, LARGE), (LARGE + 2, LARGE + 2)
WINDOW = (MARGIN, MARGIN + REGION[0], MARGIN, MARGIN + REGION[1])
VIEW = visibility.SkyView(lines(), satellites(NUM_SATELLITES, 1), WHOLE)

NUM_AZIMUTHS, NUM_BEAMS, RANGE_M = 360, 16, 100.0
STEPS_5M = hard.num_steps(5.0, RANGE_M)
RAYS = hard.ray_offsets(NUM_AZIMUTHS, STEPS_5M)
STARTS = hard.phase_starts(RAYS, 1)
RAYS_5M = {"halo": STEPS_5M - 1}
HALO_5M, PADDED_5M = lidar.halo_cells(Lidar(), 5.0), 24
PADDED_STARTS = hard.phase_starts(hard.ray_offsets(NUM_AZIMUTHS, PADDED_5M), 1, HALO_5M)
SCAN = soft_lidar.Scan(NUMBER, NUMBER, NUMBER, array(NUM_BEAMS), array(NUM_BEAMS))


def around(shape: tuple[int, ...], halo: int, *phases: int) -> jax.ShapeDtypeStruct:
    """Return a raster with so many cells around it."""
    return array(*phases, *(side + 2 * halo for side in shape))


HALO = rounded_up(distance.window_cells(Risk().threshold_m, 5.0))
RUN_M2, AROUND = array(HALO + 1), distance.disc(50.0, 5.0, jnp.float32)
EDGES = float64(*REGION), float64(1024, 2), float64(1024, 2), float64()
LINE = {"is_line": True, "passes_corners": array(dtype=bool)}

NUM_QUERIES, NUM_TILES = 256, 32  # on a map of 1,024 cells a side
GRID_OF_TILES = tiles.TileGrid(
    float64(NUM_TILES * tiles.SIDE + 2, NUM_TILES * tiles.SIDE + 2),
    array(NUM_TILES * tiles.SIDE, NUM_TILES * tiles.SIDE, dtype=jnp.uint8),
    dict.fromkeys(STEPS, (1, 1.0, 1.0, 1.0)),
)
TOGETHER = {"num_together": TILES_TOGETHER["gpu"] * NUM_QUERIES}


ENDS_OF_TILES = int32(NUM_QUERIES, 2)
BOUND_OF_TILES = float64(NUM_QUERIES, NUM_TILES, NUM_TILES)


def open_tiles() -> tiles.Search:
    with jax.enable_x64(True):
        return jax.eval_shape(tiles.begin, ENDS_OF_TILES, ENDS_OF_TILES, BOUND_OF_TILES)


NUM_NODES = 16_384
SAMPLES = sample_graph.Samples(
    int32(NUM_NODES),
    float64(NUM_NODES, 2),
    *[float64(NUM_NODES)] * 9,
    int32(NUM_NODES),
    float64(NUM_NODES),
)
GRAPH = sample_graph.Sizes(
    64, 16, min(NODES_TOGETHER["gpu"], NUM_NODES), min(EDGES_TOGETHER["gpu"], 16 * NUM_NODES)
)
NAMES = ("distance", "gps", "lidar", "population", "risk")
NUM_DEMONSTRATIONS, NUM_ROUTES, NUM_NOISE = 64, 128, 64
TARGETS = (Target("mean_gps", ">=", 0.8), Target("detour", "<=", 0.2))
FIT = fenchel_young.FitTask(
    float64(NUM_DEMONSTRATIONS, 5),
    float64(NUM_DEMONSTRATIONS, NUM_ROUTES, 5),
    float64(NUM_DEMONSTRATIONS, NUM_NOISE, 5),
    float64(NUM_DEMONSTRATIONS),
)
BOUND, SIGN = float64(2), float64(2)
KNOWN = target_fit._Aim(
    BOUND, SIGN, float64(NUM_DEMONSTRATIONS, NUM_ROUTES, 10), float64(NUM_DEMONSTRATIONS, 10)
)
WISHES = {"names": NAMES, "targets": TARGETS}


BLOCKS = population.BlockPopulation(
    array(40_000), array(40_000), array(40_000, dtype=jnp.uint8), int32(30_000)
)


def soft_city() -> SoftCity:
    grid = Grid("EPSG:32618", 5.0, 0, 0, *SURFACE)
    region = Grid("EPSG:32618", 5.0, MARGIN, MARGIN, *REGION)
    surface = Surface(array(*SURFACE), None, None, int32(*REGION), grid, region)
    return SoftCity(surface, int32(*SURFACE), array(40_000), VIEW, BLOCKS)


def soft_people(block, blocks, params):
    return population.soft_population(block, blocks, "day", params)


def soft_shadow_weights(roof_m, shadow_lines):
    """Return how much each satellite counts, of roofs."""
    return satellite_weights(20.0, shadow_heights(roof_m, shadow_lines, WINDOW), 2.0)


def nearest(roof_m, run_m2):
    return distance.nearest_column(roof_m, 20.0, 50.0, 10.0, run_m2)


def nearest_at(roof_m, ground_m, heights_m, cells):
    heights = heights_m, 50.0, 10.0
    return distance.nearest_column_at(roof_m, ground_m, *heights, cells, AROUND, halo=HALO)


def returns_at(roof_m, ground_m, heights_m, scan, cells):
    return soft_lidar.soft_returns_at(
        soft_lidar.ScansAt(roof_m, ground_m, heights_m, scan, RAYS, 2.0, cells)
    )


def inputs() -> tuple[at_once.MapInputs, visibility.SkyView]:
    """Return what all maps of a region of 8 M cells at one time are made of."""
    settings = {"gps": gps.Gps(), "population": population.Population()}
    ready = {"lidar": array(4, PADDED_5M), "population": (BLOCKS, array(2))}
    fixed = ("lidar", Lidar()), ("risk", Risk())
    geometry = satellites(NUM_SATELLITES, ROUNDED)
    sky = visibility.SkyView(lines_over(SURFACE, ROUNDED), geometry, WHOLE)
    return at_once.MapInputs(soft_city().surface, ALTITUDES_M, ready, settings, fixed), sky


NUM_TIMES = 24


def region(num_times: int = 1) -> tuple[at_once.MapInputs, visibility.SkyView]:
    """Return what a device makes all maps of a region of 8 M cells of: sides and satellites are rounded up."""
    made, sky = inputs()
    people = ("block", "population")
    surface = replace(made.surface, block=None, has_data=array(*SURFACE, dtype=bool))
    settings = {name: values for name, values in made.settings.items() if name not in people}
    ready = {name: values for name, values in made.ready.items() if name not in people}
    skies = jax.tree.map(
        lambda values: np.stack([np.asarray(values)] * num_times), sky._replace(num=NUM_SATELLITES)
    )
    return replace(made, surface=surface, settings=settings, ready=ready), skies


def with_floor() -> tuple[at_once.MapInputs, visibility.SkyView]:
    """Return the same with the GPS floor, whose threshold is traced."""
    made, skies = region()
    return replace(made, settings={**made.settings, "gps_floor": GpsFloor()}), skies


WALKS = rays.Walks(*[array(rays.RAYS_A_TURN)] * 5)
RINGS = sweep.Ring(*[array(blocks.AT_ONCE, LARGE + 2)] * 2, *[array(blocks.AT_ONCE, LARGE)] * 2)
ROOFS = blocks.Roofs(array(*BLOCK), None, NUMBER)

KERNELS: dict[str, Callable[[], Call]] = {
    "all maps": lambda: Call(jax.jit(at_once.all_maps), inputs()),
    "a region's maps": lambda: Call(at_once.region_maps, region(), {"keeps_times": True}),
    "a region's maps with the GPS floor": lambda: Call(
        at_once.region_maps, with_floor(), {"keeps_times": True}
    ),
    "a region's maps, statistics over 24 times": lambda: Call(
        at_once.region_maps, region(NUM_TIMES), {"keeps_times": False}
    ),
    "shadows: doubling": lambda: Call(
        jax.jit(sweep.heights_by_doubling, static_argnames="window"),
        (array(*SURFACE), lines()),
        {"window": (0, SURFACE[0], 0, SURFACE[1])},
    ),
    # On the host alone: row by row.
    "shadows: a block": lambda: Call(
        blocks.cast,
        (
            blocks.Block(
                ROOFS,
                array(4, 1, 1),
                lines_over(GROWN, blocks.AT_ONCE),
                RINGS,
                array(blocks.AT_ONCE, dtype=jnp.uint32),
                WHOLE,
                (WHOLE, WHOLE),
                (WHOLE, WHOLE),
            ),
        ),
    ),
    "shadows: words": lambda: Call(
        sweep.words_along_lines,
        (array(*SURFACE), array(4, 1, 1), lines_over(SURFACE, ROUNDED), WHOLE),
        {"window": WINDOW},
    ),
    "obstacle": lambda: Call(jax.jit(surface.obstacle_mask), (array(*REGION), ALTITUDES_M)),
    "risk": lambda: Call(
        risk._risk,
        (around(REGION, HALO), None, None, ALTITUDES_M, NUMBER, NUMBER, RUN_M2, None),
    ),
    "shadows: height": lambda: Call(sweep.shadow_height, (array(*SURFACE), line(SURFACE))),
    "shadows: sweep": lambda: Call(sweep.sweep, (array(*SURFACE), line(SURFACE))),
    "shadows: rays": lambda: Call(
        rays.walk, (array(*SURFACE), *[int32(rays.RAYS_A_TURN)] * 2, WALKS, array())
    ),
    "shadows: soft weights, gradient": lambda: Call(
        gradient(soft_shadow_weights), (array(*SURFACE), lines())
    ),
    "DOPs of weights": lambda: Call(dop.dops, (satellites(9, 1), array(9, gps.BLOCK_CELLS))),
    "DOPs of words": lambda: Call(
        dop.dops_of_words, (satellites(9), array(1, *REGION, dtype=jnp.uint32))
    ),
    "GPS maps, 9 satellites": lambda: Call(
        gps.maps_of_words, (array(1, *REGION, dtype=jnp.uint32), satellites(9), NUMBER)
    ),
    "GPS floor, 9 satellites": lambda: Call(
        least_heights,
        (
            array(ROUNDED, *REGION),
            array(*REGION),
            satellites(NUM_SATELLITES, ROUNDED),
            NUMBER,
        ),
        {"dop": "gdop"},
    ),
    "DOPs of weights, 2 clocks, gradient": lambda: Call(
        gradient(lambda geometry, weights: dop.dops(geometry, weights).gdop, 1),
        (satellites(16, 1, 2), array(16, gps.BLOCK_CELLS)),
    ),
    "GPS, soft": lambda: Call(
        gps_soft._soft_gps,
        (array(*SURFACE), array(*SURFACE), None, NUMBER, NUMBER, NUMBER, VIEW, None, None),
        {"window": WINDOW, "dop": "gdop"},
    ),
    "lidar: flat, 5 m": lambda: Call(
        hard.count_returns, (around(REGION, STEPS_5M - 1, 1), array(1, STEPS_5M), STARTS), RAYS_5M
    ),
    "lidar: flat by steps": lambda: Call(
        hard.count_returns_by_steps,
        (around(REGION, STEPS_5M - 1, 1), array(1, STEPS_5M), STARTS),
        RAYS_5M,
    ),
    "lidar: terrain, tile": lambda: Call(
        hard.count_returns_on_terrain_by_steps,
        (
            around(TILE, STEPS_5M - 1, 1),
            around(TILE, STEPS_5M - 1, 1),
            array(1, STEPS_5M, NUM_BEAMS),
            STARTS,
        ),
        RAYS_5M,
    ),
    "lidar: a block": lambda: Call(
        lidar._lidar,
        (around(BLOCK, HALO_5M), None, array(1), array(1, PADDED_5M), PADDED_STARTS),
        {"halo": HALO_5M, "oversample": 1},
    ),
    "lidar: soft, tile": lambda: Call(
        soft_lidar.soft_returns, (around(TILE, STEPS_5M - 1), SCAN, RAYS, NUMBER)
    ),
    "lidar: soft, tile, gradient": lambda: Call(
        gradient(soft_lidar.soft_returns, (0, 1)), (around(TILE, STEPS_5M - 1), SCAN, RAYS, NUMBER)
    ),
    "lidar: soft, of a path": lambda: Call(
        soft_lidar.soft_returns_at,
        (
            soft_lidar.ScansAt(
                around(REGION, STEPS_5M - 1), None, HEIGHTS_M, SCAN, RAYS, NUMBER, CELLS
            ),
        ),
    ),
    "lidar: soft, of a path, terrain, gradient": lambda: Call(
        gradient(returns_at),
        (around(REGION, STEPS_5M - 1), around(REGION, STEPS_5M - 1), HEIGHTS_M, SCAN, CELLS),
    ),
    "distance, 5 m": lambda: Call(distance.capped_distance, (around(REGION, HALO), RUN_M2, NUMBER)),
    "distance over terrain": lambda: Call(
        distance.capped_distance_over_terrain,
        (
            array(*REGION),
            around(REGION, HALO),
            array(*around(REGION, HALO).shape, dtype=bool),
            AROUND,
            NUMBER,
        ),
    ),
    "distance: soft": lambda: Call(
        distance.nearest_column, (around(REGION, HALO), NUMBER, NUMBER, NUMBER, RUN_M2)
    ),
    "distance: soft, gradient": lambda: Call(gradient(nearest), (around(REGION, HALO), RUN_M2)),
    "distance: soft, of a path": lambda: Call(
        distance.nearest_column_at,
        (around(REGION, HALO), None, HEIGHTS_M, NUMBER, NUMBER, CELLS, AROUND),
        {"halo": HALO},
    ),
    "distance: soft, of a path, terrain, gradient": lambda: Call(
        gradient(nearest_at, (0, 1)), (around(REGION, HALO), around(REGION, HALO), HEIGHTS_M, CELLS)
    ),
    "obstacle: soft": lambda: Call(surface.soft_obstacle, (array(*REGION), NUMBER, NUMBER)),
    "population: of blocks": lambda: Call(
        population.layers_of_blocks, (BLOCKS, array(2), population.Population())
    ),
    "population, gradient by gammas": lambda: Call(
        gradient(soft_people, 2), (int32(*REGION), BLOCKS, population.Population())
    ),
    "edges of BIT*, line": lambda: Call(segment_costs, EDGES, LINE, True),
    "BIT*: a batch": lambda: Call(
        sample_graph.search_samples,
        (SAMPLES, float64(*REGION), float64(), array(dtype=bool)),
        {"is_line": True, "sizes": GRAPH},
        True,
    ),
    "highest homeward": lambda: Call(
        _highest_east, (array(2001, 8002), float64(), float64()), {}, True
    ),
    "tiles: begin": lambda: Call(
        tiles.begin, (ENDS_OF_TILES, ENDS_OF_TILES, BOUND_OF_TILES), {}, True
    ),
    "tiles: advance": lambda: Call(
        tiles.advance_tiles, (open_tiles(), GRID_OF_TILES, float64(), WHOLE), TOGETHER, True
    ),
    "cost of a route, gradient by heights": lambda: Call(
        buildings._slopes,
        (soft_city(), SoftParams(20.0), Weights(), PathVisits(CELLS, HEIGHTS_M, NUMBER)),
    ),
    "tuner: descend": lambda: Call(
        fenchel_young.descend,
        (float64(5), FIT),
        {"objective": fenchel_young.fenchel_young_loss, "num_steps": 200},
        True,
    ),
    "tuner: bootstrap": lambda: Call(
        confidence._fits, (float64(5), FIT, float64(100, NUM_DEMONSTRATIONS)), {}, True
    ),
    "tuner: targets, descend": lambda: Call(
        target_fit._descend, (float64(6, 5), float64(128, 5), KNOWN), WISHES, True
    ),
    "tuner: targets, candidates": lambda: Call(
        target_fit._known_misses, (float64(1000, 5), KNOWN), WISHES, True
    ),
}
