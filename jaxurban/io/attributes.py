"""What variables of maps tell of their files by attributes, and what stands for no value there.

Inside obstacles files hold no value, as none was computed there; the engine holds 0.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

CAVEAT = "comment"  # what whoever reads the values must know; the name is that of the CF conventions
IN_OBSTACLES = "in_obstacles"  # what the engine holds inside obstacles, where files hold no value
NEEDED = ("obstacle", "has_data")  # which cells these are; without them it is not a folder of maps


def names_in(attributes: Mapping[str, Any], name: str) -> list[str]:
    """Return the names in an attribute, which holds them as one text: NetCDF 3 takes no lists of texts."""
    return [part for part in attributes.get(name, "").split(", ") if part]


def no_value(dtype: np.dtype) -> Any:
    """Return what stands for no value in files: NaN, the highest unsigned number; None where there is nothing such."""
    return {"f": np.nan, "u": np.iinfo(dtype).max if dtype.kind == "u" else None}.get(dtype.kind)


def cells_inside(ds: xr.Dataset, array: xr.Variable, key: tuple) -> np.ndarray | None:
    """Return which cells of a part of a map lie inside obstacles; None where the map holds values of its own there."""
    if IN_OBSTACLES not in array.attrs:
        return None
    at = dict(zip(array.dims, key, strict=True))
    kept = [dim for dim in array.dims if np.ndim(at[dim]) or isinstance(at[dim], slice)]
    found = []
    for dims, name in ((ds.variables[name].dims, name) for name in NEEDED):
        own = tuple(at[dim] for dim in dims)
        found.append(xr.Variable([dim for dim in dims if dim in kept], ds.variables[name][own].values))
    return ((found[0] != 0) & found[1]).set_dims(kept).values  # altitudes may come before times


def with_hideable(ds: xr.Dataset) -> xr.Dataset:
    """Return maps without `IN_OBSTACLES` where somebody has put what stands for no value inside obstacles."""
    ds = ds.copy()
    for name, array in ds.variables.items():
        for place in np.ndindex(array.shape[:-2]) if IN_OBSTACLES in array.attrs else ():
            part = (*place, slice(None), slice(None))
            if is_hidden(array[part].values, cells_inside(ds, array, part)).any():
                ds[name].attrs = {key: value for key, value in array.attrs.items() if key != IN_OBSTACLES}
                break
    return ds


def is_hidden(values: np.ndarray, is_inside: np.ndarray | None) -> np.ndarray:
    """Return where a file's values stand for what the engine holds: of counts also in a chunk that is not there."""
    return is_nothing(values) & (values.dtype.kind == "u" or is_inside)


def is_nothing(values: np.ndarray) -> np.ndarray:
    """Return where values stand for none."""
    return np.isnan(values) if values.dtype.kind == "f" else values == no_value(values.dtype)
