"""What importing, calling and starting jaxurban does to a process: to what it imports and holds."""

import subprocess
import sys

import pytest

from jaxurban.cli.main import app
from jaxurban.flights.export.write import FORMATS
from jaxurban.paths.suffixes import ROUTES

HEAVY = "dask geopandas jax matplotlib numba numpy pandas pydantic pyproj rasterio scipy shapely xarray zarr"


def heavy_modules(code: str) -> list[str]:
    """Return which heavy packages a new process has imported after some code."""
    told = f"import sys\n{code}\nprint(*sorted(set({HEAVY!r}.split()) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1].split()


@pytest.mark.slow
def test_importing_the_package_imports_nothing_heavy():
    assert heavy_modules("import jaxurban; dir(jaxurban)") == []
    assert heavy_modules("import jax, jaxurban") != []


def test_what_needs_no_command_to_run_and_the_help_of_every_one_import_nothing_heavy():
    helps = [["--help"], *([command, "--help"] for command in app.commands)]
    run = "\ntry: main({})\nexcept SystemExit as ended: assert {} or not ended.code"
    asked = [[], ["--version"], ["maps"], ["no-command"], *helps]
    runs = "".join(run.format(each, each not in helps) for each in asked)
    assert heavy_modules(f"from jaxurban.cli.main import main{runs}") == []


def test_routes_are_written_by_the_suffixes_that_are_checked_first():
    assert tuple(FORMATS) == ROUTES


def test_a_wrong_path_is_answered_before_anything_heavy_is_imported(tmp_path):
    empty = str(tmp_path)
    lines = [
        ["info", "no.tif"],
        ["maps", "no.toml", "-o", "out"],
        ["study", "no.toml", "-o", "out"],
        ["check", "no/maps", "no.plan"],
        ["view", empty],
        ["sky", __file__, "--at", "0,0"],
    ]
    runs = "".join(
        f"\ntry: main({line})\nexcept SystemExit as e: assert e.code == 2" for line in lines
    )
    assert heavy_modules(f"from jaxurban.cli.main import main{runs}") == []


@pytest.mark.slow
def test_maps_of_the_demo_city_import_neither_stores_nor_tables_of_outlines():
    """Reading and writing files is another matter: what that needs comes when it is asked for."""
    run = "import jaxurban as ju; ju.build_maps(ju.demo_city(500, 500), altitudes_m=(20.0,), progress=False).m('gps')"
    names = heavy_modules(run)
    assert not {"dask", "geopandas", "matplotlib", "pydantic", "rasterio", "zarr"} & set(names)


# What a process holds; the cache folder of Numba apart, which is documented to be the caller's choice.
STATE = """
import gc, json, logging, os, sys
import dask, jax, matplotlib, numba, numpy, pandas, pyproj, rasterio, xarray, zarr
import distributed, geopandas, optax, pyogrio, pydantic, requests, scipy.spatial, shapely, skyfield.api, tqdm
from rasterio.env import get_gdal_config

def state():
    numbas = {key: value for key, value in vars(numba.config).items() if key.isupper() and key != "CACHE_DIR"}
    loggers = [logging.getLogger(), *filter(lambda each: isinstance(each, logging.Logger),
               (logging.getLogger(name) for name in sorted(logging.Logger.manager.loggerDict)))]
    gdal = ("GDAL_CACHEMAX", "GDAL_NUM_THREADS", "GDAL_DISABLE_READDIR_ON_OPEN", "CPL_DEBUG", "OGR_INTERLEAVED_READING",
            "OSM_USE_CUSTOM_INDEXING", "GTIFF_IMPLICIT_JPEG_OVR", "NUM_THREADS")
    return {
        "thresholds of the collector": gc.get_threshold(), "is the collector on": gc.isenabled(),
        "its callbacks": [f"{each.__module__}.{each.__qualname__}" for each in gc.callbacks],
        "frozen objects": gc.get_freeze_count(),
        "jax.config": {key: repr(value) for key, value in jax.config.values.items()},
        "numba.config": {key: repr(value) for key, value in sorted(numbas.items())},
        "logging": {each.name: [each.level, each.disabled, list(map(repr, each.handlers))]
                    for each in loggers if each.handlers or each.level},
        "gdal": {name: get_gdal_config(name) for name in gdal},
        "environment": dict(sorted(os.environ.items())),
        "recursion": sys.getrecursionlimit(), "hooks": [repr(sys.excepthook), repr(sys.unraisablehook)],
    }

def compare(stage):
    after = state()
    for name in before:
        assert before[name] == after[name], (stage, name, before[name], after[name])

before = state()
import jaxurban as ju
compare("import")
[getattr(home, name) for home in (ju, ju.studies) for name in home.__all__]
compare("every name")
import tempfile
for engine in ("jax", "numba"):
    maps = ju.build_maps(ju.demo_city(400, 400), resolution_m=20.0, altitudes_m=[60.0], engine=engine, progress=False)
    compare(engine)
with tempfile.TemporaryDirectory() as folder:
    maps.save(folder)
    maps = ju.open_maps(folder)
    free = numpy.argwhere(maps.is_free(60.0))
    ends = [tuple(map(float, maps.grid.lonlat_of_cell(*cell))) for cell in free[[0, 5]]]
    assert ju.plan(maps, *ends, altitude_m=60.0, snap=True).status.has_path
compare("files and a plan")
"""


@pytest.mark.slow
def test_the_users_process_stays_as_libraries_alone_leave_it():
    command = [sys.executable, "-W", "ignore::UserWarning", "-c", STATE]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
