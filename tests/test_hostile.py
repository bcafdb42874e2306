"""Hostile files, options and places to run in, drawn from all by a seed: an exit code, one sentence, nothing lost."""

import itertools
import json
import os
import random
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

from jaxurban.errors import InputError, readable
from tests.cli_runs import run
from tests.made_maps import made_maps
from tests.tiled_runs import files_of

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
MAPS = made_maps(24, 30)
FREE = np.argwhere(MAPS.is_free(20.0))
START, GOAL = ("{},{}".format(*MAPS.grid.lonlat_of_cell(*FREE[at])) for at in (0, -1))
WEST, SOUTH, EAST, NORTH = -74.0, 40.755, -73.995, 40.759
UTM, X, Y = "EPSG:32618", 584_000.0, 4_511_800.0
SCENARIO = f"""
[region]
bounds = [{WEST}, {SOUTH}, {EAST}, {NORTH}]
resolution_m = 40
altitudes_m = [20]
[buildings]
"""
TO_MAPS = ("maps", "town.toml", "-o", "out")
PLAN = ("plan", "../made", "--start", START, "--goal", GOAL, "--altitude", 20)
NUM = 12  # of each kind


def box(west: float = WEST + 0.001, size: float = 5e-4) -> list[list[float]]:
    south = SOUTH + 0.001
    return [
        [west, south],
        [west + size, south],
        [west + size, south + size],
        [west, south + size],
        [west, south],
    ]


def collection(properties: Any = None, geometry: Any = None) -> str:
    """Return a GeoJSON of a sound building and another one."""
    other = geometry or {"type": "Polygon", "coordinates": [box(WEST + 0.002)]}
    sound = {
        "type": "Feature",
        "properties": {"height": 12},
        "geometry": {"type": "Polygon", "coordinates": [box()]},
    }
    features = [sound, {**sound, "properties": properties, "geometry": other}]
    return json.dumps({"type": "FeatureCollection", "features": features})


DEEP = 100_000
JUNK = [
    *(
        "",
        "null",
        "5",
        "[]",
        "{}",
        " \n\t",
        "[" * DEEP,
        '{"a":' * DEEP,
        "[" * DEEP + "]" * DEEP,
        collection()[:-40],
    ),
    *(
        b"\0" * 999,
        bytes(range(256)) * 9,
        '{"type": "\xe9'.encode("latin-1"),
        "<osm><way id='1'></osm>",
    ),
    '<!DOCTYPE a [<!ENTITY b "bbbbbbbbbb"><!ENTITY c "&b;&b;&b;&b;&b;&b;">]><osm>&c;</osm>',
    *(
        '{"type": "FeatureCollection", "features": []}',
        '{"type": "FeatureCollection", "features": "none"}',
    ),
]
VALUES = ([1, 2], {"m": 3}, 1e308, "9" * 10_000, True, "nan", -5, "1e3000", [[3]], None)
RINGS = (
    [box(1e300)],
    None,
    [[["a", "b"]] * 4],
    [[[0, 0], [1, 1]]],
    [[box()[at] for at in (0, 2, 1, 3, 0)]],
)
GEOMETRIES = [
    *({"type": "Polygon", "coordinates": each} for each in RINGS),
    *({"coordinates": [box()]}, {"type": "Ball", "coordinates": [box()]}),
    {
        "type": "GeometryCollection",
        "geometries": [{"type": "GeometryCollection", "geometries": []}],
    },
]
ODD = [collection(None), *(collection(None, geometry) for geometry in GEOMETRIES)]
ODD += [
    collection(dict.fromkeys(("height", "upper", "lower", "altitude_m", "layer"), value))
    for value in VALUES
]
READERS: dict[str, tuple] = {  # by the file that is hostile
    **dict.fromkeys(
        ("b.geojson", "b.osm", "b.gpkg", "b.parquet", "b.pbf", "b.shp", "b.tif"), TO_MAPS
    ),
    **{"blocks.geojson": TO_MAPS, "o.tle": TO_MAPS, "s.toml": ("maps", "s.toml", "-o", "out")},
    **{name: (*PLAN, "--no-fly", name) for name in ("z.geojson", "z.kml")},
    **{
        name: ("tune", "../made", name, "-o", "out")
        for name in ("r.geojson", "r.csv", "r.parquet", "r.kml")
    },
}
SECTIONS = {
    "blocks.geojson": '[population]\nblocks = "blocks.geojson"\n',
    "o.tle": "[gps]\norbits = 'o.tle'\n",
}


def write_town(buildings: str = "b.geojson", more: str = "") -> None:
    """Write a scenario, and sound buildings unless there are others."""
    Path("town.toml").write_text(f'{SCENARIO}source = "{buildings}"\n{more}')
    if not Path("b.geojson").exists():
        Path("b.geojson").write_text(collection({"height": 20}))


def write_file(name: str, content: str | bytes) -> None:
    Path(name).write_bytes(
        content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content
    )
    write_town(name if name.startswith("b.") else "b.geojson", SECTIONS.get(name, ""))


ROLES = {
    "terrain": '[terrain]\nsource = "r.tif"\n',
    "blocks": '[population]\nblocks = "r.tif"\n',
    "layer": '[layers.n]\nsource = "r.tif"\ncost = "high-is-bad"\nscale = [0, 80]\n',
}
FLAT = np.ones((60, 60), np.float32) * 5
PIXELS = (
    (0, 0, X, 0, -10, Y),
    (10, 10, X, 10, 10, Y),
    (np.nan, 0, X, 0, -10, Y),
    (1e300, 0, X, 0, -1e300, Y),
    (1e-300, 0, X, 0, -1e-300, Y),
    (10, 0, 1e12, 0, -10, 1e12),
)
LOCAL_CRS = 'LOCAL_CS["a site",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
RASTERS: list[dict[str, Any]] = [
    *({"pixels": pixels} for pixels in PIXELS),
    *({"crs": crs} for crs in (LOCAL_CRS, None, "EPSG:4326", "EPSG:4978")),
    *({"values": FLAT * each} for each in (np.nan, np.inf, 1e37)),
    *({"values": each} for each in (FLAT[:1, :1], FLAT.astype(np.complex64))),
]


def write_raster(
    role: str, pixels=(10, 0, X, 0, -10, Y + 600), crs: str | None = UTM, values: np.ndarray = FLAT
) -> None:
    how = {
        "count": 1,
        "height": len(values),
        "width": len(values[0]),
        "dtype": values.dtype,
        "crs": crs,
    }
    with rasterio.open("r.tif", "w", driver="GTiff", transform=Affine(*pixels), **how) as file:
        file.write(values, 1)
    write_town("b.geojson" if role in ROLES else "r.tif", ROLES.get(role, ""))


NUMBERS = ("1e300", "-1e300", "nan", "-5", "x", "", "[1]", "99999999999999999999999x")
TEXTS = (
    "gps",
    "gps=",
    "gps=-1",
    "gps=nan",
    "gsp=1",
    "=",
    "gps>=x",
    "gsp>=0.3",
    ">=",
    "noon",
    "\0",
    "/proc/full.kml",
)
TUNE = (
    "tune",
    "../made",
    "-o",
    "out",
    "--sample",
    3,
    "--time-of-day",
    "day",
    "--pilot",
    "gps=1,distance=1",
)
SENSITIVITY = ("sensitivity", "../made", "-o", "out", *PLAN[2:])
# Commands, their options, and what is wrong for all of these.
OPTIONS: tuple[tuple[tuple, str, tuple[str, ...]], ...] = (
    (
        (*PLAN, "--report", "speed_m_s=5", "--volume"),
        "--snap --report=swath_m --volume=level_step_m --altitude",
        NUMBERS,
    ),
    (PLAN, "--resolution --start --goal --planner=seed --rules=clearance_m", NUMBERS),
    (("compare", "../made", "../made", "-o", "out"), "--routes --resolution", NUMBERS),
    (SENSITIVITY, "--range --study=num_heights --study=wrong", NUMBERS),
    (TUNE, "--fit=hold_out --fit=bootstrap --fit=budget_s --altitude --sample", NUMBERS),
    (TO_MAPS, "--memory --workers", NUMBERS),
    (
        PLAN,
        "--weights --require --time --time-of-day --planner --planner=heuristic --no-fly -o --profile",
        TEXTS,
    ),
    (SENSITIVITY, "--vary --range", TEXTS),
    (TUNE, "--metrics --pilot --wish", TEXTS),
    (TO_MAPS, "--layers --cluster --set", TEXTS),
)


def worded(option: str, value: object) -> tuple:
    """Return the words of an option; one such as ``--fit=seed`` takes ``NAME=VALUE``."""
    return (f"{option}={value}",) if "=" in option else (option, value)


def cases() -> dict[str, list[tuple[Callable[[], object], tuple]]]:
    """Return what is prepared and then run, by what it is about."""
    as_files = itertools.product(READERS, JUNK)
    as_odd = itertools.product(("b.geojson", "blocks.geojson", "z.geojson", "r.geojson"), ODD)
    return {
        "junk": [(partial(write_file, name, text), READERS[name]) for name, text in as_files],
        "odd": [(partial(write_file, name, text), READERS[name]) for name, text in as_odd],
        "rasters": [
            (partial(write_raster, role, **wrong), TO_MAPS)
            for role in ("b", *ROLES)
            for wrong in RASTERS
        ],
        "options": [
            (write_town, (*command, *worded(option, value)))
            for command, options, values in OPTIONS
            for option, value in itertools.product(options.split(), values)
        ],
    }


@pytest.mark.parametrize("about", ["junk", "odd", "rasters", "options"])
def test_hostile_input_ends_in_one_sentence_or_a_result(about, tmp_path, monkeypatch, capsys):
    """What must be refused is: junk, a number or a name that an option does not take."""
    MAPS.save(tmp_path / "made")
    for number, (prepare, command) in enumerate(random.Random(about).sample(cases()[about], NUM)):
        folder = tmp_path / f"{number}"
        folder.mkdir()
        monkeypatch.chdir(folder)
        prepare()
        given = files_of(folder)
        code, _, err = run(capsys, *command)
        assert code in (2, 3, 4) or (code == 0 and about != "junk"), (command, code, err)
        assert "Traceback" not in err
        *_, last = ["", *err.splitlines()]
        assert len(last) < 1500
        if code == 2:
            assert sum(line.startswith("jaxurban: error: ") for line in err.splitlines()) == 1, err
            assert [
                name
                for name in files_of(folder)
                if "jaxurban-part" in name or name.endswith(".lock")
            ] == []
        assert given.items() <= files_of(folder).items()


COMMAND = f"{sys.executable} -m jaxurban"
ROUTE = " ".join((COMMAND, *map(str, PLAN)))
TOWN = f"{COMMAND} {' '.join(TO_MAPS)}"
NOWHERE = "/proc/none"
PLACES: dict[str, tuple[str, tuple[int, ...], dict[str, str]]] = {
    **{
        f"stdout {where}": (f"{ROUTE} --json {where}", (0, 2), {})
        for where in (">&-", ">/dev/full", ">&- 2>&-")
    },
    "a reader that leaves": (f"{ROUTE} --json | true; exit ${{PIPESTATUS[0]}}", (0,), {}),
    "no room for a route": (f"ulimit -f 0; {ROUTE} -o path.geojson", (2,), {}),
    "no room for maps": (f"ulimit -f 40; {TOWN}", (2,), {"JAX_COMPILATION_CACHE_DIR": NOWHERE}),
    "PROJ without its data": (TOWN, (0, 2), {"PROJ_DATA": NOWHERE, "PROJ_LIB": NOWHERE}),
    "GDAL without its data": (TOWN, (0, 2), {"GDAL_DATA": NOWHERE}),
    "no home, no caches": (
        ROUTE,
        (0, 2),
        {"HOME": NOWHERE, "NUMBA_CACHE_DIR": NOWHERE, "XDG_CACHE_HOME": NOWHERE},
    ),
    "no folder for scratch": (ROUTE, (0, 2), {"TMPDIR": NOWHERE}),
    "a folder that is held": (f"mkdir out; exec 9>out/.jaxurban.lock; flock 9; {TOWN}", (2,), {}),
}


@pytest.mark.parametrize(("command", "codes", "environment"), PLACES.values(), ids=PLACES.keys())
def test_a_hostile_place_ends_in_one_sentence_or_a_result(command, codes, environment, tmp_path):
    folder = tmp_path / "place"
    folder.mkdir()
    MAPS.save(tmp_path / "made")
    (folder / "town.toml").write_text(f'{SCENARIO}source = "synthetic"\n')
    how = {"cwd": folder, "env": os.environ | environment, "capture_output": True}
    done = subprocess.run(["bash", "-c", command], text=True, check=False, **how)
    assert done.returncode in codes, done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("*.jaxurban-part"))


def unpacked(values):
    first, second = values
    return first, second


@pytest.mark.parametrize(
    "broken",
    [
        lambda: json.loads("[" * DEEP),
        lambda: list(zip([1], [], strict=True)),
        lambda: unpacked([1]),
        lambda: unpacked([1, 2, 3]),
        lambda: int("9" * 5000),
    ],
)
def test_what_python_says_of_its_own_work_becomes_what_is_wrong_with_a_file(tmp_path, broken):
    (tmp_path / "a").write_text("")
    with pytest.raises(InputError) as caught, readable(tmp_path / "a", "a mission", "mend it"):
        broken()
    for word in ("recursion", "zip()", "unpack", "sys.", "argument"):
        assert word not in str(caught.value)
