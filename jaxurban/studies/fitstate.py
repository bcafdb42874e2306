"""What a fit keeps between rounds, so that one that was interrupted goes on."""

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.store import whole_file
from jaxurban.studies.pool import RoutePool


@dataclass(frozen=True, eq=False)
class FitState:
    """Where a fit stood after its last whole round.

    Attributes:
      log_weights: ``[K]``.
      rows: the learning curve.
    """

    log_weights: np.ndarray
    rows: list[dict[str, Any]]


def save_state(
    file: str | Path | None, settings: Mapping[str, Any], pool: RoutePool, log_weights: np.ndarray, rows: list
) -> None:
    """Write the state of a fit; nothing without a file."""
    if file is None:
        return
    with whole_file(Path(file)) as scratch, scratch.open("wb") as stream:
        arrays: dict[str, Any] = {
            "settings": np.array(json.dumps(settings)),
            "rows": np.array(json.dumps(rows)),
            "log_weights": log_weights,
            **pool.to_arrays(),
        }
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def load_state(file: str | Path | None, settings: Mapping[str, Any], pool: RoutePool) -> FitState | None:
    """Return the state to go on from, its routes given to the pool; None where there is none.

    Raises:
      InputError: the file is damaged, or belongs to other examples or settings.
    """
    if file is None or not Path(file).exists():
        return None
    try:
        with np.load(file, allow_pickle=False) as stored:
            arrays = dict(stored)
        kept_settings, rows = (json.loads(str(arrays[name])) for name in ("settings", "rows"))
        log_weights = arrays["log_weights"]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"{str(file)!r} is no state of a fit: remove it, or name another folder") from error
    if kept_settings != dict(settings):
        raise InputError(f"{str(file)!r} belongs to a fit with other settings: remove it, or name another folder")
    pool.restore(arrays)
    return FitState(log_weights, rows)
