"""Hostile settings and options: every number of a scenario and of the commands, out of all bounds."""

import itertools
from collections.abc import Iterator
from pathlib import Path

from jaxurban.maps.scenario import Scenario, fields_of, model_in
from tests.campaign.cases import REFUSED, TOLD, Case

OPEN = ("layers", "weights")  # sections whose keys are names that a user chooses
SCENARIO = """[region]
bounds = [-74.0, 40.755, -73.995, 40.759]
resolution_m = 25
altitudes_m = [20, 60]
[buildings]
source = "synthetic"
[gps]
times = ["2020-04-27T16:00:00Z"]
"""
NUMBERS = ("1e300", "-1", "nan", "-inf", "'ten'", "[[]]", "{}", "true", "1e-320", "99999999999999999999")
TEXTS = ("5", "[[1]]", "{}", "''", "'no\\u0000such'", "'/dev/null'")
MAPS = ("maps", "{in}/scenario.toml", "-o", "{out}")
SMALLEST = ("1e-320",)  # a number like any other to what has no least one
ENDS = ("--start", "-73.999,40.7555", "--goal", "-73.9955,40.7585")
PLAN = ("plan", "{base}", *ENDS, "--altitude", "20", "--snap")


def write_scenario(folder: Path) -> None:
    """Write a small scenario of the synthetic city."""
    (folder / "scenario.toml").write_text(SCENARIO)


def kind_of(key: str) -> str:
    """Return whether a setting is ``"number"``, ``"text"``, or something else."""
    section, _, name = key.partition(".")
    model = model_in(fields_of(Scenario)[section])
    annotation = str(fields_of(model)[name]) if model and name else ""
    if "bool" in annotation or "Literal" in annotation:
        return "choice"
    return "number" if "float" in annotation or "int" in annotation else "text" if "str" in annotation else "other"


def keys_of(model: type) -> list[str]:
    """Return every dotted key of a scenario but those of the sections that a user names keys in."""
    found = []
    for section, annotation in fields_of(model).items():
        inner = None if section in OPEN else model_in(annotation)
        found += [section] if inner is None else [f"{section}.{key}" for key in fields_of(inner)]
    return found


def of_settings() -> Iterator[Case]:
    """Yield each setting of a scenario with each wrong value."""
    for key in keys_of(Scenario):
        kind = kind_of(key)
        values = {"number": NUMBERS, "choice": ("5", "'x'", "[]"), "text": TEXTS, "other": ("5", "'x'")}[kind]
        for value in values:
            is_wrong = kind in ("number", "choice") and value not in SMALLEST and "." in key
            codes = REFUSED if is_wrong and not _may_pass(key, value) else TOLD
            yield Case(f"--set {key}={value}", (*MAPS, "--set", f"{key}={value}"), write_scenario, codes)


def _may_pass(key: str, value: str) -> bool:
    """Return whether a value is none that a setting must refuse: another of its kinds, or one as good as any."""
    if value in ("'ten'", "'x'", "{}", "[]", "[[]]", "5"):
        return key in (
            "population.normalise",
            "study.weights",
            "buildings.height_std_m",
            "study.distance_only",
            "layers",
        )
    return (key, value) in (("buildings.height_std_m", "true"), ("planning.connectivity", "5"))


def of_options() -> Iterator[Case]:
    """Yield wrong options of the commands over finished maps."""
    numbers = ("1e300", "-1e300", "nan", "inf", "-5", "x", "")
    for option in ("--altitude", "--resolution", "--snap", "--budget", "--speed", "--swath", "--level-step"):
        more = (
            ("--volume",) if option == "--level-step" else ("--report", "--speed", "5") if option == "--swath" else ()
        )
        for value in numbers:
            if (option, value) in (("--budget", "inf"), ("--budget", "1e300"), ("--swath", "inf")):
                continue
            yield Case(f"plan {option} {value!r}", (*PLAN, *more, option, value))
    for option, value in itertools.product(
        ("--start", "--goal"), ("nan,0", "1e300,0", "40.7", "0,0", "a,b", "1,2,3", "91,181")
    ):
        yield Case(f"plan {option} {value!r}", (*PLAN, option, value))
    for option, value in (
        *(("--weights", text) for text in ("gps", "gps=", "gps=-1", "gps=1e300", "gps=nan", "gsp=1", "=", "gps=1=2")),
        *(("--require", text) for text in ("gps", "gps>=x", "gps>=nan", "gsp>=0.3", "gps=>1", "gps>=1e300", ">=")),
        *(("--time", text) for text in ("now", "0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z", "\x00", "2020")),
        *(("--time-of-day", text) for text in ("noon", "weekday-99", "")),
        *(("--planner", text) for text in ("a*", "", "astar-volume")),
        *(("--heuristic", text) for text in ("x", "")),
        *(("--no-fly", text) for text in ("no-such.kml", "{base}", "/dev/null", "{base}/run.json")),
        *(("-o", text) for text in ("path.txt", "/proc/none.kml", "{base}", "/proc/full.kml", "no/such/place.kml")),
        *(("--profile", text) for text in ("path.txt", "/proc/none.png")),
        *(("--seed", text) for text in ("-1", "1.5", "99999999999999999999999999x")),
    ):
        yield Case(f"plan {option} {value!r}", (*PLAN, option, value))
    compare = ("compare", "{base}", "{base}", "-o", "{out}")
    for option, value in (
        *(("--tolerance", text) for text in ("-1", "nan", "1e300", "x")),
        *(("--time", text) for text in ("now", "a=b", "==")),
        *(("--resolution", text) for text in ("7", "nan", "-1")),
    ):
        yield Case(f"compare {option} {value!r}", (*compare, option, value))
    study = ("study", "{in}/scenario.toml", "-o", "{out}", "--set", "study.budget_iterations=10", "--workers", "1")
    for option, value in (
        *(("--resolution", text) for text in ("7", "nan", "1e300", "-1")),
        *(("--workers", text) for text in ("0", "-1", "1.5", "x")),
        *(("--set", f"study.budget_iterations={text}") for text in ("0", "-1", "1e3")),
        *(("--instances", text) for text in ("no-such.csv", "{in}/scenario.toml", "/dev/null")),
        *(("--require", text) for text in ("gsp>=1", "gps")),
        ("--cluster", "nowhere"),
    ):
        yield Case(f"study {option} {value!r}", (*study, option, value), write_scenario)
    sensitivity = ("sensitivity", "{base}", "-o", "{out}", *ENDS, "--altitude", "20", "--snap")
    for option, value in (
        *(("--range", text) for text in ("1", "2,3", "0,1", "nan,2", "a,b", "1e300,1e301")),
        *(("--samples", text) for text in ("3", "-1", "0.5", "x")),
        *(("--vary", text) for text in ("gsp", "distance,distance", ",")),
    ):
        yield Case(
            f"sensitivity {option} {value!r}", (*sensitivity, option, value), codes=TOLD if value == "," else REFUSED
        )
    for option, value in (
        *(("--sample", text) for text in ("0", "-1", "x", "1.5")),
        *(("--hold-out", text) for text in ("-1", "2", "nan", "1e300")),
        *(("--metrics", text) for text in ("gsp", "")),
        *(("--bootstrap", text) for text in ("-1", "x")),
        *(("--pilot", text) for text in ("gps", "gps=-1", "gsp=1", "gps=0")),
        *(("--wish", text) for text in ("mean_gps", "beauty>=1", "mean_gps>=2", "detour<=nan")),
        *(("--budget", text) for text in ("-1", "nan", "0")),
        *(("--altitude", text) for text in ("nan", "21", "1e300")),
    ):
        given = () if option in ("--sample", "--pilot") else ("--pilot", "gps=1,distance=1")
        sample = () if option == "--sample" else ("--sample", "3")
        yield Case(
            f"tune {option} {value!r}",
            ("tune", "{base}", "-o", "{out}", "--time-of-day", "day", *sample, *given, option, value),
        )
    for text in (
        "gps=5",
        "gps",
        "=",
        "gps.mask_deg=",
        "gps.=1",
        "[region]",
        "a.b.c.d=1",
        "region=[]",
        "gps.mask_deg=08",
    ):
        yield Case(f"maps --set {text}", (*MAPS, "--set", text), write_scenario)
    for option, value in (
        ("--memory", "x"),
        ("--memory", "-1GiB"),
        ("--memory", "1KiB"),
        ("--memory", "nan"),
        ("--layers", "gsp"),
        ("--workers", "0"),
        ("--workers", "-1"),
        ("--cluster", "nowhere:1"),
    ):
        yield Case(f"maps {option} {value}", (*MAPS, option, value), write_scenario)
    for times in ("0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z", "1969-12-31T23:59:59Z", "2020-13-01", "0", "1e300"):
        yield Case(f"maps at {times}", (*MAPS, "--set", f"gps.times=['{times}']"), write_scenario, TOLD)
        yield Case(
            f"series from {times}",
            (
                *MAPS,
                "--set",
                f"gps.start='{times}'",
                "--set",
                "gps.stop='9999-12-31T23:59:59Z'",
                "--set",
                "gps.step_s=1",
            ),
            write_scenario,
        )
