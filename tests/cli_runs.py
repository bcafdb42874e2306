"""Running the command line in this process, and the small town that it is run on."""

import json
import math
from pathlib import Path
from unittest.mock import patch

import pytest
import shapely
from jsonschema import Draft202012Validator

from jaxurban import progress
from jaxurban.cli import main as cli

TOWN = """
[region]
bounds = [-74.0, 40.755, -73.993, 40.761]
resolution_m = 20
altitudes_m = [20, 60]
[buildings]
source = "synthetic"
"""
ENDS = "--start=-73.999,40.756", "--goal=-73.994,40.76"  # over the town


SCHEMA = json.loads(
    (Path(__file__).parents[1] / "docs/reference/json.schema.json").read_text(encoding="utf-8")
)


def run(capsys, *arguments: object) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of one command; what ``--json`` prints is held against its schema."""
    # An error stands alone only in the first seconds of a job, which may be long on a busy machine.
    with (
        pytest.raises(SystemExit) as ended,
        patch.multiple(progress, EVERY_S=math.inf, SILENT_S=600.0),
    ):
        cli.main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    if "--json" in arguments:
        check_json(out, ended.value.code, str(arguments[0]))
    return ended.value.code, out, err


def check_json(out: str, code: int, command: str) -> dict:
    """Return the one object on stdout, which is all that the schema says of a command, and nothing else."""
    printed = json.loads(out, parse_constant=pytest.fail)
    kind = command if command in SCHEMA["$defs"] else "envelope"
    alone = {"$ref": f"#/$defs/{kind}", "unevaluatedProperties": False, "$defs": SCHEMA["$defs"]}
    Draft202012Validator(alone).validate(printed)
    assert printed["exit_code"] == code
    return printed


def assert_one_sentence(err: str, *words: str) -> None:
    """Check that stderr is one error line that holds all of ``words``."""
    assert err.startswith("jaxurban: error: "), err
    assert len(err.strip().splitlines()) == 1, err
    for word in words:
        assert word in err


def outlines(*polygons: shapely.Polygon) -> str:
    """Return buildings of 30 m as GeoJSON."""
    building = {"type": "Feature", "properties": {"height": "30"}}
    features = [building | {"geometry": shapely.geometry.mapping(each)} for each in polygons]
    return json.dumps({"type": "FeatureCollection", "features": features})


def write_city(folder: Path, *polygons: shapely.Polygon) -> Path:
    """Write buildings and a scenario of them; return the scenario's file."""
    (folder / "city.geojson").write_text(outlines(*polygons))
    (folder / "town.toml").write_text(TOWN.replace("synthetic", "city.geojson"))
    return folder / "town.toml"
