"""What a fit has searched, kept in a file, so that a fit that was interrupted goes on.

All else in a fit follows from its settings and from what its searches found. A fit that is run again asks for the same
searches in the same order; those in the journal are answered from it, bit for bit, until the journal ends.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.seal import read_npz, write_npz
from jaxurban.io.store import whole_file
from jaxurban.studies.queries import Query


class Journal:
    """The searches of one fit, in order: weights ``[Q, M, K]`` and what was found ``[2, Q, M, K]``.

    Attributes:
      num_recalled: searches answered from the file so far.
    """

    def __init__(self, file: str | Path, settings: Mapping[str, Any]) -> None:
        """Begin with what the file holds, or with nothing where there is none.

        Args:
          file: written after every search.
          settings: what the fit depends on, as JSON holds it.

        Raises:
          InputError: the file is damaged, or belongs to a fit with other settings.
        """
        self.num_recalled = 0
        self._file, self._settings = Path(file), dict(settings)
        self._kept: list[tuple[np.ndarray, np.ndarray]] = []
        self._next = 0
        if self._file.exists():
            self._read()

    def recall(self, weights: np.ndarray) -> np.ndarray | None:
        """Return what was found for these weights, where they are what the journal holds next; else None."""
        if self._next < len(self._kept):
            asked, found = self._kept[self._next]
            if np.array_equal(asked, weights):
                self._next += 1
                self.num_recalled += weights.shape[0] * weights.shape[1]
                return found
        return None

    def keep(self, weights: np.ndarray, found: np.ndarray) -> None:
        """Write down what was found next, in place of all that stood there from an earlier run."""
        self._kept[self._next :] = [(np.array(weights), np.array(found))]
        self._next += 1
        arrays = {f"asked_{k}": asked for k, (asked, _) in enumerate(self._kept)}
        arrays |= {f"found_{k}": found for k, (_, found) in enumerate(self._kept)}
        arrays["settings"] = np.array(json.dumps(self._settings, sort_keys=True))
        with whole_file(self._file) as scratch:
            write_npz(scratch, arrays, is_compressed=True)

    def _read(self) -> None:
        try:
            stored = read_npz(self._file)
            settings = json.loads(str(stored["settings"]))
            self._kept = [(stored[f"asked_{k}"], stored[f"found_{k}"]) for k in range(len(stored) // 2)]
        except (OSError, ValueError, KeyError) as error:
            raise InputError(
                f"{str(self._file)!r} cannot be read as the state of a fit: remove it, pass --overwrite, or name "
                "another folder"
            ) from error
        if settings != json.loads(json.dumps(self._settings)):
            raise InputError(
                f"{str(self._file)!r} belongs to a fit of other routes, maps or settings: pass --overwrite, or name "
                "another folder"
            )


def fingerprint(queries: Sequence[Query], *arrays: np.ndarray) -> str:
    """Return a digest of queries, of the maps they lie on, and of further arrays."""
    digest = hashlib.sha256()
    for unit in {id(query.unit): query.unit for query in queries}.values():
        problem = unit.problem
        digest.update(repr((unit.names, unit.cost_model, unit.grid.resolution_m, unit.layers.shape)).encode())
        digest.update(np.ascontiguousarray(problem.layers).tobytes())
        digest.update(np.ascontiguousarray(problem.is_free).tobytes())
    for query in queries:
        digest.update(repr((query.start, query.goal)).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
