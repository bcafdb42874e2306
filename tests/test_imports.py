"""What is imported before it is needed: nothing that takes a while."""

import subprocess
import sys

import pytest

from jaxurban.cli.main import app

HEAVY = "dask geopandas jax matplotlib numba numpy pandas pydantic pyproj rasterio scipy shapely xarray zarr"


def heavy_modules(code: str) -> list[str]:
    """Return which heavy packages a new process has imported after some code."""
    told = f"import sys\n{code}\nprint(*sorted(set({HEAVY!r}.split()) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1].split()


def test_importing_the_package_imports_nothing_heavy():
    assert heavy_modules("import jaxurban; dir(jaxurban)") == []
    assert heavy_modules("import jax, jaxurban") != []


@pytest.mark.parametrize("arguments", [["--help"], [], ["--version"], ["maps"], ["no-command"]])
def test_what_needs_no_command_to_run_imports_nothing_heavy(arguments):
    run = f"from jaxurban.cli.main import main\ntry: main({arguments!r})\nexcept SystemExit: pass"
    assert heavy_modules(run) == []


def test_the_help_of_every_command_imports_nothing_heavy():
    run = "\ntry: main([{!r}, '--help'])\nexcept SystemExit as ended: assert not ended.code"
    helps = "".join(run.format(command) for command in app.commands)
    assert heavy_modules(f"from jaxurban.cli.main import main{helps}") == []


def test_maps_of_the_demo_city_import_neither_stores_nor_tables_of_outlines():
    """Reading and writing files is another matter: what that needs comes when it is asked for."""
    run = "import jaxurban as ju; ju.build_maps(ju.demo_city(500, 500), altitudes_m=(20.0,), progress=False).m('gps')"
    names = heavy_modules(run)
    assert not {"dask", "geopandas", "matplotlib", "pydantic", "rasterio", "zarr"} & set(names)
