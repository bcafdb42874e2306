"""What commands refuse: one sentence that names what is wrong, exit code 2, and nothing written."""

import os
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import click
import jax
import osmium
import pytest
from shapely import box

from jaxurban import checks
from jaxurban.terminal.common import again
from jaxurban.terminal.options import TYPED
from tests.cli_runs import ENDS, assert_one_sentence, outlines, run

NEAR = (-74.0, 40.755, -73.999, 40.756)  # a part of the town
MAPS, PLAN = "maps town.toml -o {out}", f"plan maps {' '.join(ENDS)} --altitude"
SET, FROM = f"{MAPS} --set", f"{MAPS} --set buildings.source="
ROUTE, ROUTES = (
    f"sensitivity maps {' '.join(ENDS)} --altitude 60 -o {{out}}",
    "sensitivity maps -o {out}",
)
PLACES = "start_lon,start_lat,goal_lon,goal_lat"
REFUSED = [
    ("mpas", "mpas"),
    (
        "plan maps --start=40.756,-73.999 --goal=-73.994,40.76 --altitude 60",
        "start",
        "longitude comes first",
    ),
    (
        "plan maps --start=-75,40.756 --goal=-73.994,40.76 --altitude 60",
        "start",
        "outside the region",
    ),
    ("plan maps --start=here --goal=-73.994,40.76 --altitude 60", "longitude,latitude"),
    ("plan maps --start=-73.999,40.756 --altitude 60", "--goal"),
    (f"{PLAN} 61", "altitude", "from 20 to 60 m (20, 60)", "with 61 in [region] altitudes_m too"),
    ("sky maps --at=40.756,-73.999 --altitude 60", "place", "longitude and latitude look swapped"),
    ("return maps --home=40.756,-73.999", "home", "longitude and latitude look swapped"),
    ("info map", "'map' does not exist (did you mean 'maps'?): check the path"),
    ("check maps tonw.toml", "did you mean 'town.toml'?"),
    ("check maps town.toml", "'town.toml' is a scenario, and no mission", ".plan, .waypoints"),
    ("check flown.plan maps", "'flown.plan' is a file", "exchange the two", "check DIR MISSION"),
    ("tune maps town.toml -o {out}", "'town.toml' is settings in TOML", "jaxurban maps"),
    (f"{PLAN} 60 --no-fly flown.plan", "is a mission, and no file of zones", "GeoJSON or KML"),
    (f"{PLAN} 60 --no-fly town.toml", "'town.toml' is settings in TOML"),
    ("tune maps flown.plan -o {out}", "'flown.plan' is a mission", "as .geojson, .kml or .gpx"),
    (
        "plan map --start=-73.999,40.756 --goal=-73.994,40.76 --altitude 60",
        "did you mean 'maps'?",
        "jaxurban maps SCENARIO -o map",
    ),
    ("maps section.toml -o {out}", "unknown section 'building' (did you mean 'buildings'?)"),
    ("maps key.toml -o {out}", "unknown key 'buildings.sorce' (did you mean 'source'?)"),
    ("check maps maps", "'maps' is a folder, not a mission: name a file"),
    ("check maps empty.plan", "'empty.plan' cannot be read as a mission (it is empty)"),
    ("info empty.geojson", "'empty.geojson' cannot be read as a vector file (it is empty)"),
    (f"{FROM}'\"maps\"'", "is a folder of maps", "name a file of buildings"),
    (f"{PLAN} 60 --rules clearance", "clearance_m has no value: write clearance_m=NUMBER"),
    (f"{ROUTES} --routes -3", "--routes", "-3 is not in the range"),
    (f"{ROUTES} --routes swapped.csv", "query 1: start: ", "longitude and latitude look swapped"),
    (f"{ROUTES} --routes low.csv", "query 1: the altitude is missing: give each row an altitude_m"),
    (f"{ROUTES} --altitude 200ft", "--altitude is a number of metres", "write 60.96"),
    (f"{PLAN} high", "--altitude", "'high' is not a valid number"),
    ("view maps --no-browser --size big", "--size", "'big' is not a valid number"),
    ("return maps --home=-73.999,40.756 --ceiling 400ft", "--ceiling is a number of metres"),
    (f"{PLAN} 200ft", "--altitude is a number of metres, got '200ft': write 60.96"),
    (f"{PLAN} '60 m'", "got '60 m': write 60"),
    (f"{PLAN} 60 --snap '0.1 km'", "--snap is a number of metres", "write 100"),
    (f"{PLAN} 60 --rules clearance_m=10feet", "clearance_m is a number of metres", "write 3.048"),
    (f"{SET} 'region.altitudes_m=[\"200 ft\"]'", "region: altitudes_m is a number", "write 60.96"),
    (f"{MAPS} --memory 4", "such as 4GiB"),
    (f"{PLAN} 60 --planner astr", "astar"),
    (f"{PLAN} 60 --weights gsp=1", "did you mean 'gps'"),
    (f"{PLAN} 60 --exposure 'gps>=1'", "--exposure", "population<=120"),
    (f"{PLAN} 60 --exposure 'gps<=1' --exposure 'gps<=2'", "--exposure names a layer twice"),
    (f"{PLAN} 60 --resolution 5", "20 m"),
    (f"{PLAN} 60 -o path.txt", ".geojson"),
    (f"{MAPS} --memory much", "4GiB", "much"),
    (f"{MAPS} --memory 100MiB", "raise --memory", "100.00 MiB", "resolution_m"),
    (f"{MAPS} --workers 0", "--workers", "x>=1"),
    (f"{MAPS} --workers 2 --memory 1GiB", "raise --memory", "fewer --workers"),
    (f"{MAPS} --workers 2 --cluster tcp://localhost:8786", "give either --workers", "not both"),
    (f"{MAPS} --workers 2 --device gpu", "start a `dask worker` on each"),
    (f"{MAPS} --layers hdop,rooof", "rooof", "roof"),
    ("study town.toml -o {out} --workers 2 --cluster tcp://nowhere:1", "--workers", "--cluster"),
    ("maps town.toml -o file", "cannot write to the output folder"),
    ("maps town.toml -o \udcff", "cannot write to the output folder"),
    ("maps deep.toml -o {out}", "deep.toml"),
    ("maps dotted.toml -o {out}", "dotted.toml"),
    (
        "compare maps maps -o taken",
        "notes.txt' is there already, and not from",
    ),  # before anything is read
    ("validate town.toml file -o taken", "notes.txt' is there already, and not from"),
    (f"{SET} mask_deg=10", "unknown section 'mask_deg'", "gps, "),
    (f"{SET} region.range_m=10", "'region.range_m'", "bounds, "),
    (f"{SET} gsp.mask_deg=10", "'gsp'", "'gps'"),
    (f"{SET} gps.mask_deg", "key=value"),
    (f"{SET} buildings.source=town.osm", "not TOML", "quotes"),
    (f"{SET} gps.mask_deg=95", "gps.mask_deg", "--set gps.mask_deg=95"),
    (f"{SET} gps.mask_deg=89.9", "no satellite is above", "mask_deg"),
    (f"{SET} region=5", "region", "should be an object"),
    (f"{SET} region.resolution_m=0.001", "GiB", "resolution_m"),
    (f"{SET} lidar.range_m=1e8", "GiB", "range_m"),
    (f"{SET} risk.threshold_m=1e8", "GiB", "threshold_m"),
    (f"{SET} study.instances=1000000000", "study: instances must be at most 1,000,000"),
    *(
        (f"{SET} 'gps.times=[\"{time}\"]'", f"gps: '{time}' is not a time")
        for time in (
            "9999-12-31T23:59:59-10:00",
            "0001-01-01T00:00:00+10:00",
            "1979-12-31T00:00:00Z",
        )
    ),
    (f"{FROM}'\"torn.osm.pbf\"'", "torn.osm.pbf", "cannot be read"),
    (f"{FROM}'\"far.geojson\"'", "no building in the region", "-73.95", "allow ="),
    (f"{FROM}'\"a\\u0000b.geojson\"'", "buildings", "null"),
    *(
        (f"info no{end}", f"no{end}' does not exist: check the path")
        for end in ("", ".tif", ".osm.pbf", ".geojson")
    ),
    ("view maps --no-browser --export page.txt", "page.txt", ".html"),
    ("view maps --no-browser --export no/such/place/page.html", "no/such/place"),
    ("view maps --no-browser --resolution 7", "7 m"),
    ("view maps --no-browser --size 0.0001", "--size"),
    ("view maps --no-browser --size nan", "size_mib must be a finite number"),
    ("view maps --no-browser --size inf", "size_mib must be a finite number"),
    (f"{PLAN} nan", "altitude_m must be a finite number"),
    (f"{PLAN} 60 --planner bitstar-plus,budget_s=inf", "budget_s must be a finite number"),
    ("check maps town.toml --heights geoid_m=nan", "geoid_m must be a finite number"),
    ("view maps --no-browser --port 99999", "--port"),
    ("view maps --no-browser --port {port}", "cannot listen", "--port"),
    (f"{ROUTE} --range 1", "--range", "0.1,10"),
    (f"{ROUTE} --range 2,3", "range"),
    (f"{ROUTE} --routes 3", "--routes"),
    (f"{ROUTES} --start=-73.999,40.756", "--goal"),
    (f"{ROUTES} --range 0,1", "range"),
    (f"{ROUTES} --altitude low", "--altitude", "20,60"),
    (f"{ROUTES} --study wrong=1", "wrong"),
    (f"{ROUTES} --vary gpss", "a weight that varies", "'gps'", "'gpss'"),
    (f"{ROUTES} --vary gps,gps", "vary must name each weight once", "gps, gps"),
    (f"{ROUTES} --vary gps --weights gps=0", "weight gps is 0 on every route"),
    (
        f"{ROUTES} --weights gps=0,lidar=0,risk=0,population=0",
        "every metric has weight 0",
        "give one a weight",
    ),
    ("sensitivity maps maps -o {out}", "maps, maps", "name each once"),
    *(
        [("demo -o {out} --device gpu", "there is no GPU that JAX can use")]
        if jax.default_backend() == "cpu"
        else []
    ),
]


@pytest.fixture(scope="module")
def desk(made, tmp_path_factory):
    """Return a folder of the town's scenario and maps, and of files that are of no use."""
    desk = tmp_path_factory.mktemp("desk")
    shutil.copy(made.parent / "town.toml", desk)
    (desk / "maps").symlink_to(made)
    for name, text in {
        "file": "a file",
        "taken/notes.txt": "mine",
        "empty.plan": "",
        "empty.geojson": "",
        "swapped.csv": f"{PLACES},altitude_m\n40.756,-73.999,40.76,-73.994,60\n",
        "low.csv": f"{PLACES}\n-73.999,40.756,-73.994,40.76\n",
        "flown.plan": '{"fileType": "Plan", "mission": {"items": []}}',
        "section.toml": '[region]\nresolution_m = 20\n[building]\nsource = "synthetic"\n',
        "key.toml": '[region]\nresolution_m = 20\n[buildings]\nsorce = "synthetic"\n',
        "deep.toml": "a = " + "{a = " * 3000 + "1" + "}" * 3000,
        "dotted.toml": ".".join("a" * 5000) + " = 1",
        "far.geojson": outlines(box(-73.95, 40.75, -73.949, 40.751)),
    }.items():
        (desk / name).parent.mkdir(exist_ok=True)
        (desk / name).write_text(text)
    with osmium.SimpleWriter(str(desk / "torn.osm.pbf")) as writer:
        for i in range(4000):
            writer.add_node(
                osmium.osm.mutable.Node(id=i + 1, location=(NEAR[0] + i * 1e-6, NEAR[1]))
            )
    whole = (desk / "torn.osm.pbf").read_bytes()
    (desk / "torn.osm.pbf").write_bytes(whole[: len(whole) * 2 // 3])
    return desk


@pytest.mark.parametrize(
    ("line", "words"), [(line, words) for line, *words in REFUSED], ids=[row[0] for row in REFUSED]
)
def test_bad_input_is_one_sentence_and_exit_code_2_and_writes_nothing(
    desk, tmp_path, capsys, monkeypatch, line, words
):
    monkeypatch.chdir(desk)
    before = sorted(desk.rglob("*"))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        given = shlex.split(line.format(out=tmp_path / "out", port=taken.getsockname()[1]))
        code, out, err = run(capsys, *given)
    assert (code, out) == (2, "")
    assert_one_sentence(err, *words)
    assert not [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert sorted(desk.rglob("*")) == before


@pytest.mark.slow
@pytest.mark.parametrize(
    "setting", ["JAX_PLATFORMS=bogus", "JAX_PLATFORMS=cuda", "JAX_ENABLE_X64=bogus"]
)
def test_a_variable_of_the_environment_that_libraries_refuse_is_one_sentence(
    desk, tmp_path, setting
):
    name, value = setting.split("=")
    command = [sys.executable, "-m", "jaxurban", "maps", desk / "town.toml", "-o", tmp_path / "out"]
    done = subprocess.run(command, env=os.environ | {name: value}, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert_one_sentence(done.stderr.splitlines()[-1], name)
    assert "Traceback" not in done.stderr


def test_what_several_workers_need_is_asked_for_before_anything_is_read(
    desk, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(desk)
    monkeypatch.setattr(checks, "find_spec", {"cryptography": ""}.get)
    monkeypatch.setattr(Path, "read_text", None)  # a scenario cannot be read
    for words in (
        "maps town.toml --workers 2",
        "study town.toml --workers 2",
        f"{ROUTES} --workers 2",
    ):
        line = words if "-o" in words else f"{words} -o {{out}}"
        code, _, err = run(capsys, *shlex.split(line.format(out=tmp_path / "out")))
        assert code == 2
        assert_one_sentence(err, "--workers", "not installed", "pip install 'jaxurban[cluster]'")


def test_a_damaged_extract_without_bounds_is_refused_in_a_sentence(capsys, tmp_path):
    for name in ("junk.osm.pbf", "junk.osm"):
        (tmp_path / name).write_bytes(b"<html>no extract</html>")
        code, _, err = run(capsys, "info", tmp_path / name)
        assert code == 2
        assert_one_sentence(err, name, "is a web page: fetch the file again")


def test_a_command_that_runs_again_leaves_out_settings_that_a_shell_quotes():
    typed = ["--set", "study.weights=[{gps=2.0}]", "--set", "region.resolution_m=[15]", "-o", "a b"]
    with click.Context(click.Command("study")) as context:
        context.meta[TYPED] = ["study", "town", *typed]
        said = again("-o", "--set study.weights", "--set study.instances")
    assert said == "jaxurban study town --set 'region.resolution_m=[15]'"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("check", "out", "a.plan", "--when", "16:00"), "No such option '--when': give --time"),
        (("plan", "out", "--height", "60"), "No such option '--height': give --altitude"),
        (("plan", "out", "--metric", "gps"), "No such option '--metric' (see jaxurban --help)"),
        (("check", "out", "a.plan", "--max-people", "9"), "give --limits max_people=..."),
        (("check", "out", "a.plan", "--ceiling", "50"), "give --limits ceiling_m=..."),
        (("maps", "a.toml", "-o", "out", "--workers", "abc"), "'abc' is not a valid whole number"),
    ],
)
def test_an_option_that_means_another_one_names_it(capsys, arguments, sentence):
    code, _, messages = run(capsys, *arguments)
    assert code == 2
    assert sentence in messages
