"""What variables of maps tell of their files by attributes, and what stands for no value there."""

from collections.abc import Mapping
from typing import Any

import numpy as np

CAVEAT = "comment"  # what whoever reads the values must know; the name is that of the CF conventions
NEEDED = ("obstacle", "has_data")  # which cells these are; without them it is not a folder of maps


def names_in(attributes: Mapping[str, Any], name: str) -> list[str]:
    """Return the names in an attribute, which holds them as one text: NetCDF 3 takes no lists of texts."""
    return [part for part in attributes.get(name, "").split(", ") if part]


def no_value(dtype: np.dtype) -> Any:
    """Return what stands for no value in files: NaN, the highest unsigned number; None where there is nothing such."""
    return {"f": np.nan, "u": np.iinfo(dtype).max if dtype.kind == "u" else None}.get(dtype.kind)
