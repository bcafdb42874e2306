"""Fields: the costs from every cell of a map to a goal, of many goals, maps and weights at once.

Landmarks stand on them, and so do queries that share a goal.
"""

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Literal, NamedTuple

import jax
import numpy as np

from jaxurban.errors import one_of
from jaxurban.kernels.search.cost_to_go import CostFields, FieldMaps, advance, begin
from jaxurban.planners.base import Cell, Problem
from jaxurban.planners.graph import graph_of, zero_heuristic
from jaxurban.planners.moves import STEPS
from jaxurban.planners.search.grid import EXHAUSTED, GridSearch

Backend = Literal["auto", "numba", "jax"]


class TileWork(NamedTuple):
    """How a device relaxes tiles: what changes its speed and nothing else.

    Attributes:
      tile, num_passes, unroll: see `kernels.search.cost_to_go.advance`.
      tiles_a_field, max_tiles: tiles relaxed in one round, for each field and of all together.
    """

    tile: int
    num_passes: int
    unroll: int
    tiles_a_field: int
    max_tiles: int


# A CPU relaxes a cell least often with small tiles and few passes; a GPU wants few rounds of few launches, each of much
# work (docs/planners.md counts both).
TILE_WORK = {"cpu": TileWork(16, 8, 1, 64, 256), "gpu": TileWork(32, 16, 14, 128, 1024)}
FIELDS_TOGETHER = 16
BYTES_OF_FIELDS = {"cpu": 2**30, "gpu": 24 * 2**30}  # of the fields that are made together, with their maps
BYTES_A_CELL = 25  # of a field, before and after some rounds, and of a map of its own
ROUNDS_AT_ONCE = 64  # between two looks at the clock


def field_backend(backend: Backend = "auto") -> Literal["numba", "jax"]:
    """Return what makes fields: the backend named, or for ``"auto"`` JAX where it has a GPU, else Numba.

    Raises:
      InputError: an unknown backend.
    """
    if one_of("backend", backend, ("auto", "numba", "jax")) == "auto":
        return "numba" if jax.default_backend() == "cpu" else "jax"
    return "numba" if backend == "numba" else "jax"


def symmetric_costs(
    problems: Sequence[Problem], backend: Backend = "auto", end_s: float = np.inf
) -> Iterator[np.ndarray]:
    """Yield ``[Y, X]`` of each problem the costs between its goal and every cell, inf without a way.

    Under the ``cell`` model half of each of a step's two cells is counted (see `landmarks`), so that the cost is the
    same both ways.

    Args:
      problems: of any maps and weights; their starts play no part.
      backend: see `field_backend`. ``"numba"`` is Dijkstra's search, goal by goal; ``"jax"`` relaxes tiles of all
        fields together, which suits a GPU (see `kernels.search.cost_to_go`). They differ by rounding alone.
      end_s: time of `time.perf_counter` to give up at.

    Raises:
      InputError: an unknown backend.
      TimeoutError: the clock passed it.
    """
    if field_backend(backend) == "numba":
        return (_by_dijkstra(problem, end_s) for problem in problems)
    # In a thread that a Ctrl-C lets end: see `frontier`.
    with ThreadPoolExecutor(1, thread_name_prefix="fields") as worker:
        return iter(worker.submit(_by_tiles, problems, end_s).result())


def warm_up_fields(problems: Sequence[Problem], backend: Backend = "auto") -> None:
    """Compile what makes as many fields on maps of these shapes, so that their time is their own."""
    if field_backend(backend) == "jax":
        with ThreadPoolExecutor(1, thread_name_prefix="fields") as worker:
            for indices in _groups(problems):
                worker.submit(FieldRun, [problems[index] for index in indices]).result()


def share_costs_to_go(
    problems: Sequence[Problem], backend: Backend = "auto", end_s: float = np.inf
) -> list[np.ndarray]:
    """Return ``[Y, X]`` of each problem the exact cost from every cell to its goal, inf without a way.

    The fields are kept with their maps for all queries to the same goals, until other goals' take their place: a search
    with ``heuristic="exact"`` then walks down on them. Those that are kept already are not made again.

    Args:
      problems, backend, end_s: as in `symmetric_costs`.

    Raises:
      InputError: an unknown backend.
      TimeoutError: the clock passed it; nothing new is kept.
    """
    fields = [problem.shared.get("cost_to_go", {}).get(problem.goal) for problem in problems]
    missing = [k for k, field in enumerate(fields) if field is None]
    if not missing:
        return fields
    made = symmetric_costs([problems[k] for k in missing], backend, end_s)
    for k, costs in zip(missing, made, strict=True):
        fields[k] = _directed(problems[k], costs)
    kept: dict[int, dict[Cell, np.ndarray]] = {}
    for problem, field in zip(problems, fields, strict=True):
        kept.setdefault(id(problem.shared), {})[problem.goal] = field
    for problem in problems:
        problem.shared["cost_to_go"] = kept[id(problem.shared)]
    return fields


def cost_to_go(problem: Problem, backend: Backend = "auto", end_s: float = np.inf) -> np.ndarray:
    """Return one problem's field of `share_costs_to_go`."""
    return share_costs_to_go([problem], backend, end_s)[0]


def has_cost_to_go(problem: Problem) -> bool:
    """Return whether the costs to the problem's goal are there already."""
    return problem.goal in problem.shared.get("cost_to_go", {})


def _directed(problem: Problem, costs: np.ndarray) -> np.ndarray:
    """Return the costs to the goal, given the symmetric ones."""
    if problem.cost_model.kind != "cell":
        return costs
    half = 0.5 * (problem.cost[problem.goal] - np.where(problem.is_free, problem.cost, 0.0))
    return np.maximum(costs + half, 0.0)  # rounding might leave less


def _by_dijkstra(problem: Problem, end_s: float) -> np.ndarray:
    search = GridSearch(graph_of(problem, is_symmetric=True), zero_heuristic(problem), problem.goal, None)
    if search.run(end_s=end_s) != EXHAUSTED:
        raise TimeoutError
    return search.costs_from_start().reshape(problem.is_free.shape)


def _by_tiles(problems: Sequence[Problem], end_s: float) -> list[np.ndarray]:
    """Return the fields by active tiles, as many together as fit of one shape."""
    found: dict[int, np.ndarray] = {}
    for indices in _groups(problems):
        run = FieldRun([problems[index] for index in indices])
        found |= zip(indices, run.costs(end_s), strict=True)
    return [found[index] for index in range(len(problems))]


def _groups(problems: Sequence[Problem]) -> Iterator[list[int]]:
    """Yield the problems' numbers in groups of one shape that may run together."""
    by_shape: dict[tuple[int, ...], list[int]] = {}
    for index, problem in enumerate(problems):
        by_shape.setdefault(problem.is_free.shape, []).append(index)
    for indices in by_shape.values():
        num_together = _num_together(problems[indices[0]])
        for first in range(0, len(indices), num_together):
            yield indices[first : first + num_together]


def _device() -> str:
    return "cpu" if jax.default_backend() == "cpu" else "gpu"


def _num_together(problem: Problem) -> int:
    return max(1, min(FIELDS_TOGETHER, BYTES_OF_FIELDS[_device()] // (BYTES_A_CELL * problem.is_free.size)))


class FieldRun:
    """Symmetric costs of problems on maps of one shape, on the device: begun and compiled.

    Attributes:
      work: how their tiles are relaxed.
      fields: what is known of them so far.
    """

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.num_fields, self.shape = len(problems), problems[0].is_free.shape
        self.work = work = TILE_WORK[_device()]
        maps = list({id(problem.cost): problem for problem in problems}.values())
        number = {id(problem.cost): k for k, problem in enumerate(maps)}
        # To a power of two, so that few shapes are compiled: fields without a goal, and the first map again.
        num_empty = _power_of_two(len(problems)) - len(problems)
        goals = np.array([problem.goal for problem in problems] + [(-1, -1)] * num_empty, np.int32)
        map_index = np.array([number[id(problem.cost)] for problem in problems] + [0] * num_empty, np.int32)
        maps += maps[:1] * (_power_of_two(len(maps)) - len(maps))
        self.options = {
            "steps": STEPS[: max(problem.cost_model.connectivity for problem in problems)],
            "num_together": min(work.tiles_a_field * len(goals), work.max_tiles),
            "tile": work.tile,
            "num_passes": work.num_passes,
            "unroll": work.unroll,
        }
        with jax.enable_x64(True):
            self.maps = _field_maps(maps, work.tile)
            self.fields: CostFields = begin(goals, map_index, self.shape, work.tile)
            self.fields = jax.block_until_ready(advance(self.fields, self.maps, 0, **self.options))

    def costs(self, end_s: float = np.inf) -> list[np.ndarray]:
        """Return ``[Y, X]`` of every problem the final costs; `TimeoutError` past ``end_s``."""
        with jax.enable_x64(True):
            while np.isfinite(self.fields.pending).any():
                if time.perf_counter() >= end_s:
                    raise TimeoutError
                self.fields = advance(self.fields, self.maps, ROUNDS_AT_ONCE, **self.options)
            # Copied one by one: what JAX lends is read-only, for which the searches would be compiled anew.
            rows, cols = (slice(1, 1 + size) for size in self.shape)
            return [np.array(self.fields.cost[k, rows, cols]) for k in range(self.num_fields)]


def _field_maps(maps: Sequence[Problem], tile: int) -> FieldMaps:
    """Return the maps on the device; the band is what a way straight through a tile of mean cost takes."""
    graphs = [graph_of(problem, is_symmetric=True) for problem in maps]
    shares = np.array([(graph.step_cost, graph.from_share, graph.to_share) for graph in graphs])
    mean = np.array([problem.cost[problem.is_free].mean() for problem in maps])
    band = tile * (shares[:, 0, 0] + (shares[:, 1, 0] + shares[:, 2, 0]) * mean)
    arrays = (np.stack([problem.cost for problem in maps]), np.stack([problem.moves for problem in maps]))
    return FieldMaps(*jax.device_put((*arrays, *shares.swapaxes(0, 1), band)))


def _power_of_two(number: int) -> int:
    return 1 << (number - 1).bit_length()
