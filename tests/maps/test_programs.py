"""How many XLA programs maps of a shape that was never seen take to compile."""

import re
import subprocess
import sys

import pytest

MOST_PROGRAMS = {"numba": 5, "jax": 8}
COMPILED = re.compile(r"Finished XLA compilation of (.+) in [\d.e-]+ sec")
MAPS = """
import jax
import jaxurban as ju

city = ju.demo_city(600, 700)
jax.config.update("jax_log_compiles", True)
maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0, 60.0, 100.0), engine="ENGINE")
assert {"gps", "lidar", "population", "risk"} <= set(maps.ds)
"""


@pytest.mark.parametrize("engine", MOST_PROGRAMS)
def test_maps_of_a_new_shape_in_a_new_process_compile_few_programs(engine):
    """Every operation of JAX outside a jitted function would be one more."""
    done = subprocess.run(
        [sys.executable, "-c", MAPS.replace("ENGINE", engine)], capture_output=True, text=True, check=True
    )
    programs = COMPILED.findall(done.stderr)
    assert "jit(maps_of_words)" in programs  # JAX still tells of them as this test expects
    assert len(programs) <= MOST_PROGRAMS[engine], programs
