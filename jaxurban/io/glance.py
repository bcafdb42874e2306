"""What a folder of maps says of itself, read without xarray in a moment: wrong options are refused by it."""

import json
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numcodecs import Zstd

from jaxurban.io.stored import METADATA, stored_maps, stored_settings


def glance(folder: Path) -> Any:
    """Return the facts of the only maps in a folder; None of several, or of damaged ones, whose opening says more.

    Returns:
      ``attrs``, ``sizes`` and ``variables`` (each with its ``attrs``) as of the dataset; ``recorded``, the settings of
      the run; ``altitudes_m``; and ``times``, ISO 8601.
    """
    with suppress(
        OSError, LookupError, TypeError, ValueError, RuntimeError
    ):  # of NumPy, JSON, Zstandard
        (path,) = stored_maps(folder).values()
        parts = json.loads((path / METADATA).read_bytes())["metadata"]

        def values(axis: str, dtype: str) -> np.ndarray:
            """Return the values along an axis, which are in one chunk."""
            return np.frombuffer(Zstd().decode((path / axis / "0").read_bytes()), dtype)

        attrs = parts[".zattrs"]
        return SimpleNamespace(
            attrs=attrs,
            sizes={axis: parts[f"{axis}/.zarray"]["shape"][0] for axis in "yx"},
            variables={
                name.removesuffix("/.zattrs"): SimpleNamespace(attrs=part)
                for name, part in parts.items()
                if name.endswith("/.zattrs")
            },
            recorded=stored_settings(folder) or json.loads(attrs.get("settings", "{}")),
            altitudes_m=values("altitude", "<f8").tolist(),
            times=[f"{time}Z" for time in values("time", "<M8[s]")],
        )
    return None
