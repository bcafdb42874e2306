"""The memory plan: what fits, what is refused, and that a real run stays under its ceiling."""

import subprocess
import sys

import pytest

from jaxurban.errors import InputError
from jaxurban.layers import MapParams
from jaxurban.maps import open_maps
from jaxurban.memory import parse_bytes, plan_memory, shape_of_tiles, tile_bytes
from jaxurban.metrics.gps import GpsParams

GIB = 2**30


@pytest.mark.parametrize(
    ("text", "num_bytes"), [("4GiB", 4 * GIB), ("512 MB", 512 * 2**20), ("1.5g", 3 * GIB // 2), ("2048", 2048)]
)
def test_sizes_are_read(text, num_bytes):
    assert parse_bytes(text) == num_bytes


@pytest.mark.parametrize("text", ["", "GiB", "-4GiB", "0", "4 gigs", "4GiB free"])
def test_what_is_no_size_is_refused(text):
    with pytest.raises(InputError, match="such as 4GiB"):
        parse_bytes(text)


def test_as_many_tiles_at_a_time_as_fit():
    plan = plan_memory(None, 1000, 3, has_processes=False)
    assert plan.num_workers == 3
    assert plan.needed_bytes <= plan.ceiling_bytes
    each = 2 * GIB
    assert plan_memory(plan.needed_bytes + int(1.5 * each), each, 8, has_processes=False).num_workers == 1


def test_a_job_that_cannot_fit_is_refused_naming_the_knob():
    with pytest.raises(InputError, match="raise --memory"):
        plan_memory(GIB // 8, GIB, 2, has_processes=False)
    with pytest.raises(InputError, match="fewer --workers"):
        plan_memory(2 * GIB, 1000, 64, has_processes=True)


def test_tiles_do_not_depend_on_the_machine_and_shrink_for_long_series():
    short, long = MapParams(), MapParams(gps=GpsParams(series="statistics"))
    assert shape_of_tiles((10_000, 5_000), short, 1) == (1000, 1000)
    rows, cols = shape_of_tiles((10_000, 5_000), long, 288)
    assert rows * cols * 288 * 4 * 4 <= 400 * 2**20
    assert tile_bytes((rows, cols), 5.0, long, 288, False) < 3 * tile_bytes((1000, 1000), 2.0, short, 1, True)


@pytest.mark.slow
def test_a_run_stays_under_its_ceiling_on_a_region_that_needs_several_times_more_at_once(tmp_path):
    """20 million cells at 4 altitudes: 3.1 GB of maps alone, under 1.25 GiB, of which libraries take the half."""
    (tmp_path / "scenario.toml").write_text(
        '[region]\nbounds = [-74.03, 40.69, -73.912, 40.76]\nresolution_m = 2\n[buildings]\nsource = "synthetic"\n'
    )
    code = (
        "import resource, sys; from jaxurban.cli import main\n"
        "try: main(sys.argv[1:])\n"
        "finally: print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    arguments = ["maps", tmp_path / "scenario.toml", "-o", tmp_path / "out", "--memory", "1.25GiB"]
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    assert int(done.stdout.split()[-1]) * 1024 < 1.25 * GIB
    assert open_maps(tmp_path / "out").ds.nbytes > 2 * 1.25 * GIB
