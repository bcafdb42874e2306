"""Altitudes, times and layers added to finished maps: every file as if all had been made at once, whoever is killed."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

from jaxurban.io.files import read_json
from jaxurban.maps import recipe
from jaxurban.scenario import provenance
from tests.cli_runs import assert_one_sentence, run
from tests.tiled_runs import files_of

TIMES = ["2020-04-27T16:00:00Z", "2020-04-27T20:00:00Z", "2020-04-28T03:00:00Z"]
TEXT = """
[region]
bounds = [-74.013, 40.705, -74.003, 40.713]
resolution_m = 20
altitudes_m = {altitudes_m}
{more}
[buildings]
source = "synthetic"
[gps]
times = {times}
[lidar]
range_m = 60
{layers}
"""
LAYERS = {
    name: f'[layers.{name}]\nsource = "{name}.tif"\ncost = "high-is-bad"\nscale = [0, 80]\n'
    for name in ("noise", "dust")
}


def write_layers(folder: Path) -> None:
    rng, side = np.random.default_rng(3), 100
    for name in LAYERS:
        with rasterio.open(
            folder / f"{name}.tif",
            "w",
            driver="GTiff",
            width=side,
            height=side,
            count=1,
            dtype="float32",
            crs="EPSG:32618",
            transform=Affine(25.0, 0, 582_800, 0, -25.0, 4_508_500),
        ) as file:
            file.write(rng.uniform(0, 80, (1, side, side)).astype(np.float32))


def scenario_file(folder: Path, altitudes_m=(60,), times=TIMES[:1], layers=(), more="", name="town.toml") -> Path:
    text = TEXT.format(
        altitudes_m=list(altitudes_m), times=list(times), layers="".join(LAYERS[each] for each in layers), more=more
    )
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def maps_of(folder: Path) -> dict[str, bytes]:
    """Return every file but the record, which tells when it was written."""
    return {name: data for name, data in files_of(folder).items() if name != "run.json"}


def counted_places(monkeypatch) -> list[tuple[str, tuple[int, ...]]]:
    """Return the list that fills with each map that a metric is asked for."""
    made: list[tuple[str, tuple[int, ...]]] = []
    at = recipe.TileScene.at

    def counted(tile, metric, place, only_m=False):
        made.append((metric.name, place))
        return at(tile, metric, place, only_m)

    monkeypatch.setattr(recipe.TileScene, "at", counted)
    return made


SMALL: dict[str, Any] = {"altitudes_m": (60,), "times": TIMES[1:2]}


@pytest.mark.parametrize(
    ("first", "then", "new"),
    [
        pytest.param(
            SMALL,
            SMALL | {"altitudes_m": (60, 122)},
            {"gps": 1, "lidar": 1, "risk": 1},
            id="higher",
            marks=pytest.mark.slow,
        ),
        pytest.param(SMALL, SMALL | {"altitudes_m": (15, 60)}, {"gps": 1, "lidar": 1, "risk": 1}, id="lower"),
        pytest.param(SMALL, SMALL | {"times": TIMES}, {"gps": 2}, id="times around", marks=pytest.mark.slow),
        pytest.param(SMALL, SMALL | {"layers": ("noise",)}, {"noise": 1}, id="layer"),
        pytest.param(
            SMALL | {"layers": ("noise",)},
            {"altitudes_m": (122, 15, 60), "times": TIMES[::-1], "layers": ("dust", "noise")},
            {"gps": 8, "lidar": 2, "risk": 2, "dust": 1},
            id="all, in another order",
        ),
        pytest.param(
            SMALL | {"more": "oversample = 3"},
            {"altitudes_m": (15, 60), "times": TIMES[:2], "more": "oversample = 3"},
            {"gps": 3, "lidar": 1, "risk": 1},
            id="supersampled",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_what_is_added_gives_the_folder_that_is_made_at_once(first, then, new, tmp_path, monkeypatch, capsys):
    write_layers(tmp_path)
    assert run(capsys, "maps", scenario_file(tmp_path, **first), "-o", tmp_path / "grown")[0] == 0
    file = scenario_file(tmp_path, **then)
    assert run(capsys, "maps", file, "-o", tmp_path / "whole")[0] == 0
    made = counted_places(monkeypatch)
    code, _, err = run(capsys, "maps", file, "-o", tmp_path / "grown")
    assert code == 0, err
    assert "adding to the maps" in err
    assert {name: sum(each == name for each, _ in made) for name in dict.fromkeys(each for each, _ in made)} == new
    whole, grown = maps_of(tmp_path / "whole"), maps_of(tmp_path / "grown")
    assert sorted(whole) == sorted(grown)
    assert [name for name in whole if whole[name] != grown[name]] == []
    assert len({read_json(tmp_path / name / "run.json")["run_key"] for name in ("whole", "grown")}) == 1
    assert run(capsys, "maps", file, "-o", tmp_path / "grown")[0] == 0  # finished, and kept
    assert maps_of(tmp_path / "grown") == whole


@pytest.mark.parametrize(
    ("then", "words"),
    [
        ({"altitudes_m": (122,)}, "region.altitudes_m was [60.0], now [122.0]"),
        ({"altitudes_m": (60, 122), "more": "oversample = 3"}, "region.oversample was 1, now 3"),
        ({"times": TIMES[:1]}, "gps.times was"),
        ({"times": [f"2020-04-27T{h:02}:{m:02}:00Z" for h in (20, 21) for m in range(0, 60, 4)]}, "gps.times was"),
    ],
)
def test_what_is_taken_away_or_changed_is_refused_and_nothing_is_touched(then, words, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(capsys, "maps", scenario_file(tmp_path, **SMALL), "-o", out)[0] == 0
    before = files_of(out)
    code, _, err = run(capsys, "maps", scenario_file(tmp_path, **SMALL | then), "-o", out)
    assert code == 2
    assert_one_sentence(err, words)
    assert files_of(out) == before


def test_styles_go_with_the_geotiffs_that_are_asked_for_no_more(tmp_path, capsys):
    out, file = tmp_path / "out", scenario_file(tmp_path, **SMALL)
    assert run(capsys, "maps", file, "-o", out, "--layers", "hdop")[0] == 0
    assert list((out / "geotiff").glob("hdop_*.qml"))
    file = scenario_file(tmp_path, **SMALL | {"altitudes_m": (60, 122)})
    assert run(capsys, "maps", file, "-o", out)[0] == 0
    assert not list((out / "geotiff").glob("hdop_*"))


def test_a_changed_file_is_named_beside_what_would_have_been_added(tmp_path, capsys):
    write_layers(tmp_path)
    out, file = tmp_path / "out", scenario_file(tmp_path, **SMALL, layers=("noise",))
    assert run(capsys, "maps", file, "-o", out)[0] == 0
    (tmp_path / "dust.tif").replace(tmp_path / "noise.tif")
    larger = scenario_file(tmp_path, **SMALL | {"altitudes_m": (60, 122)}, layers=("noise",))
    code, _, err = run(capsys, "maps", larger, "-o", out)
    assert code == 2
    assert_one_sentence(err, "now [60.0, 122.0]) and of other input files (layer_noise: what they hold has changed)")


@pytest.mark.slow
def test_damaged_maps_are_not_built_upon(tmp_path, capsys):
    out, file = tmp_path / "out", scenario_file(tmp_path, **SMALL)
    assert run(capsys, "maps", file, "-o", out)[0] == 0
    chunk = max((path for path in (out / "maps.zarr/20m/lidar").rglob("*") if path.is_file()), key=os.path.getsize)
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 255
    chunk.write_bytes(bytes(data))
    larger = scenario_file(tmp_path, **SMALL | {"altitudes_m": (60, 122)})
    code, _, err = run(capsys, "maps", larger, "-o", out)
    assert code == 0
    assert "missing or damaged" in err
    assert run(capsys, "maps", larger, "-o", tmp_path / "whole")[0] == 0
    assert maps_of(out) == maps_of(tmp_path / "whole")


def test_maps_of_other_code_are_not_added_to(tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    assert run(capsys, "maps", scenario_file(tmp_path, **SMALL), "-o", out)[0] == 0
    monkeypatch.setattr(provenance, "code_hash", lambda: "other code")
    code, _, err = run(capsys, "maps", scenario_file(tmp_path, **SMALL | {"altitudes_m": (60, 122)}), "-o", out)
    assert code == 2
    assert_one_sentence(err, "region.altitudes_m")


KILLED_AT = {  # what a process does instead of going on
    "a tile half written": ("jaxurban.maps.tiled", "write_layer", 4),
    "the new maps in place of the old ones": ("jaxurban.io.files", "shutil.rmtree", 1),
    "the second GeoTIFF": ("jaxurban.io.geotiff", "write_cog", 2),
    "the record": ("jaxurban.scenario.run", "write_record", 1),
}
KILLER = """
    import importlib, os, signal, sys
    from operator import attrgetter

    module, name, number, *arguments = sys.argv[1:]
    *path, last = name.split(".")
    home = importlib.import_module(module)
    home = attrgetter(".".join(path))(home) if path else home
    function, calls = getattr(home, last), []

    def killed(*args, **kwargs):
        calls.append(1)
        if len(calls) == int(number):
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*args, **kwargs)

    setattr(home, last, killed)
    from jaxurban.cli.main import main

    main(arguments)
"""


@pytest.mark.slow
def test_kill_9_while_maps_are_added_to_loses_nothing(tmp_path, capsys):
    file, out = scenario_file(tmp_path, **SMALL), tmp_path / "out"
    assert run(capsys, "maps", file, "-o", out)[0] == 0
    file = scenario_file(tmp_path, altitudes_m=(15, 60), times=TIMES[:2])
    for where, (module, name, number) in KILLED_AT.items():
        command = [sys.executable, "-c", textwrap.dedent(KILLER), module, name, str(number), "maps", str(file)]
        ended = subprocess.run([*command, "-o", str(out)], capture_output=True, text=True, check=False)
        assert ended.returncode == -signal.SIGKILL, (where, ended.stderr)
    code, _, err = run(capsys, "maps", file, "-o", out)
    assert code == 0, err
    assert run(capsys, "maps", file, "-o", tmp_path / "whole")[0] == 0
    assert maps_of(out) == maps_of(tmp_path / "whole")
