"""GDAL's cache of blocks: off while blocks pass once, and then as it was, whoever else works."""

from threading import Barrier, Thread

from rasterio.env import get_gdal_config

from jaxurban.io.gdal import SETTING, without_cache


def test_the_cache_comes_back_when_the_last_of_several_threads_leaves():
    before = get_gdal_config(SETTING)
    assert before > 0
    both_in, first_out, seen = Barrier(2, timeout=60), Barrier(2, timeout=60), []

    def work(is_first: bool) -> None:
        with without_cache():
            both_in.wait()
            seen.append(get_gdal_config(SETTING))
            if not is_first:
                first_out.wait()
                seen.append(get_gdal_config(SETTING))
        if is_first:
            first_out.wait()

    threads = [Thread(target=work, args=(is_first,)) for is_first in (True, False)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen == [0, 0, 0]
    assert get_gdal_config(SETTING) == before


def test_the_cache_comes_back_after_an_error():
    before = get_gdal_config(SETTING)
    try:
        with without_cache():
            raise OSError
    except OSError:
        pass
    assert get_gdal_config(SETTING) == before
