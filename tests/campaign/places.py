"""Hostile places to run in: no room, no reader, no home, broken libraries' settings, another run in the folder."""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from tests.campaign.cases import MOST_S, REFUSED, TOLD, Verdict, fault_of, scraps
from tests.campaign.settings import ENDS, write_scenario

COMMAND = f"{sys.executable} -m jaxurban"
PLAN = " ".join((COMMAND, "plan $BASE", *ENDS, "--altitude 20 --snap"))
MAPS = f"{COMMAND} maps scenario.toml -o out"


@dataclass(frozen=True)
class Place:
    """A command of the shell in a place, what is set there, and how it may end; ``may_leave``: files of ours."""

    name: str
    command: str
    codes: tuple[int, ...] = REFUSED
    environment: dict[str, str] = field(default_factory=dict)
    may_leave: bool = False


def of_places() -> list[Place]:
    """Return all of them."""
    nowhere = "/proc/none"
    script = "import jaxurban as ju\nju.study('{base}', 'out', 2, workers=2, progress=False)\n"
    return [
        Place("stdout closed", f"{PLAN} >&-", TOLD),
        Place("stdout closed, JSON", f"{PLAN} --json >&-", TOLD),
        Place("stdout full", f"{PLAN} >/dev/full"),
        Place("stdout full, JSON", f"{PLAN} --json >/dev/full"),
        Place("help into a full stdout", f"{COMMAND} --help >/dev/full"),
        Place("stderr closed", f"{PLAN} 2>&-", TOLD),
        Place("both closed", f"{PLAN} >&- 2>&-", TOLD),
        Place("stdout to a reader that leaves", f"{PLAN} --json | true; exit ${{PIPESTATUS[0]}}", TOLD),
        Place("no room for maps", f"ulimit -f 4; {MAPS}"),
        Place("no room for a route", f"ulimit -f 0; {PLAN} -o path.geojson"),
        Place("no room for a study", f"ulimit -f 8; {COMMAND} study scenario.toml -o out --workers 1"),
        Place("no room for a fit", f"ulimit -f 1; {COMMAND} tune $BASE --sample 3 --pilot gps=1 -o out"),
        Place("PROJ without its data", MAPS, TOLD, {"PROJ_DATA": nowhere, "PROJ_LIB": nowhere}),
        Place("GDAL without its data", MAPS, TOLD, {"GDAL_DATA": nowhere}),
        Place("Matplotlib without a folder", f"{MAPS} --figures", TOLD, {"MPLCONFIGDIR": nowhere}),
        Place("Matplotlib of another backend", f"{MAPS} --figures", TOLD, {"MPLBACKEND": "none-such"}),
        Place("no home", PLAN, TOLD, {"HOME": nowhere, "XDG_CACHE_HOME": nowhere}),
        Place("no home, no caches", PLAN, TOLD, {"HOME": nowhere, "NUMBA_CACHE_DIR": nowhere}),
        Place(
            "a read-only install without a home",
            f"setpriv --reuid=65534 --regid=65534 --clear-groups {PLAN}",
            TOLD,
            {"HOME": nowhere, "NUMBA_CACHE_DIR": ""},
        ),
        Place("JAX's cache nowhere", PLAN, TOLD, {"JAX_COMPILATION_CACHE_DIR": nowhere}),
        Place("no folder for scratch files", PLAN, TOLD, {"TMPDIR": nowhere}),
        Place("a script without a main guard", f"{sys.executable} script.py", (1,), {"SCRIPT": script}),
        Place(
            "two runs in one folder", f"({MAPS} >/dev/null 2>&1 &) ; sleep 4; {MAPS}; code=$?; wait; exit $code", TOLD
        ),
        Place("a folder that is held", f"mkdir out; exec 9>out/.jaxurban.lock; flock 9; {MAPS}", may_leave=True),
    ]


def run_place(place: Place, base: Path) -> Verdict:
    """Return what comes of a place."""
    with tempfile.TemporaryDirectory() as folder:
        write_scenario(Path(folder))
        for path in (Path(folder), base.parent):
            path.chmod(0o755)  # for another user
        if script := place.environment.get("SCRIPT"):
            Path(folder, "script.py").write_text(script.replace("{base}", str(base)))
        environment = {**os.environ, "BASE": str(base), **place.environment}
        environment["PYTHONPATH"] = os.pathsep.join([os.getcwd(), os.environ.get("PYTHONPATH", "")])
        try:
            done = subprocess.run(
                ["bash", "-c", place.command], cwd=folder, env=environment, capture_output=True, timeout=MOST_S
            )
        except subprocess.TimeoutExpired as error:
            return Verdict(place.name, "hang", str(error))
        told = done.stderr.decode(errors="replace")
        left = [] if place.may_leave else list(scraps(Path(folder)))
    if place.codes == (1,):  # Python's own way to end by an error: one sentence, told last
        last = told.strip().splitlines()[-1]
        is_told = last.startswith("jaxurban.errors.InputError") and "__main__" in last and done.returncode == 1
        return Verdict(place.name, "" if is_told else "traceback", told)
    fault = fault_of(done.returncode, told, place.codes)
    if not fault and done.returncode and left:
        fault, told = "lost files", f"left behind: {left[0]}"
    return Verdict(place.name, fault, f"exit {done.returncode}: {told}")
