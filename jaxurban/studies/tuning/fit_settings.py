"""FitSettings: what fits of weights have in common, whatever they are fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from jaxurban.errors import InputError, at_least, one_of, typed
from jaxurban.io.tables import RowStore, fingerprint
from jaxurban.progress import Progress
from jaxurban.studies.queries import RouteQuery, maps_of
from jaxurban.studies.route_pool import Backend, RoutePool


@typed
@dataclass(frozen=True)
class FitSettings:
    """How a fit of weights searches.

    Attributes:
      max_rounds: of searches; fewer where nothing is left to better.
      seed: of all noise.
      budget_s: seconds; the fit ends after the round in which they run out.
      workers: threads of search; a thread a core if left out.
      backend: of A*: see `RoutePool`.
      state_file: searches are kept in it; a fit of the same queries and settings goes on from it, to the same
        weights, bit for bit, as if it had not stopped.
      progress: gets a call after every round, as in `jaxurban.progress.reporting`.

    Raises:
      InputError: a number that is too small.
    """

    max_rounds: int = 20
    seed: int = 0
    budget_s: float = np.inf
    workers: int | None = None
    backend: Backend = "numba"
    state_file: str | Path | None = None
    progress: Progress = False

    def __post_init__(self) -> None:
        if not (self.max_rounds >= 1 and self.budget_s > 0 and self.seed >= 0):
            raise InputError(
                "max_rounds must be >= 1, budget_s > 0 and seed >= 0, got "
                f"{self.max_rounds}, {self.budget_s} and {self.seed}"
            )
        one_of("backend", self.backend, get_args(Backend))
        if self.workers is not None:
            at_least("workers", self.workers, 1)

    def pool(self, queries: Sequence[RouteQuery], known: Sequence[np.ndarray] = (), **fit: Any) -> RoutePool:
        """Return the routes of a fit; ``fit`` holds, beside the seed, all that its searches follow from.

        All else in a fit follows from its settings and from what its searches found, so that one that was interrupted
        goes on: what is in the state file is found there, bit for bit.

        Raises:
          InputError: a state file that is damaged, or of other queries, maps or settings; another backend.
        """
        store = None
        if self.state_file is not None:
            on_maps = [
                fingerprint((on.names, on.cost_model, on.grid.resolution_m, on.costs.shape), on.costs, on.is_free)
                for on in maps_of(queries)
            ]
            routes = fingerprint(on_maps, [(query.start, query.goal) for query in queries])
            settings = {"fit of routes and maps": routes, "seed": self.seed, **fit}
            store = RowStore(Path(self.state_file), ["weights"], settings=settings)
        return RoutePool(queries, known, self.workers, store, self.backend)
