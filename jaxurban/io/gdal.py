"""How much memory GDAL keeps blocks of rasters in."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

SETTING = "GDAL_CACHEMAX"


class _Users:
    """How many work without the cache, which all threads share, and what it was before the first of them."""

    lock, num, before = Lock(), 0, 0


@contextmanager
def without_cache() -> Iterator[None]:
    """Let GDAL keep no block while the block runs: for files that are written block by block, each once."""
    from rasterio.env import get_gdal_config, set_gdal_config  # a command's start imports no rasterio

    with _Users.lock:
        if _Users.num == 0:
            _Users.before = get_gdal_config(SETTING)
            set_gdal_config(SETTING, 0)
        _Users.num += 1
    try:
        yield
    finally:
        with _Users.lock:
            _Users.num -= 1
            if _Users.num == 0:
                set_gdal_config(SETTING, _Users.before)
