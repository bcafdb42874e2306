"""Each step on the disk that fails, or is the last before a kill: one sentence, nothing lost, the same again."""

import contextlib
import functools
import itertools
import random
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

import jaxurban as ju
from jaxurban.cli.main import main
from jaxurban.errors import InputError
from jaxurban.flights.export.write import FORMATS
from jaxurban.io import tables
from jaxurban.io.files import SCRATCH_SUFFIX
from jaxurban.maps import run as pipeline
from jaxurban.maps.scenario import Scenario
from tests.faulty_disk import DAMAGES, WAYS, Killed, counted, harm, values_of
from tests.made_maps import made_maps
from tests.tiled_runs import files_of

MAPS = made_maps(24, 30)
FREE = np.argwhere(MAPS.is_free(20.0))
ENDS = [tuple(MAPS.grid.lonlat_of_cell(*FREE[at]) for at in pair) for pair in ((0, -1), (3, -5))]
PATHS = ju.plan_many(
    MAPS, ENDS, altitude_m=20.0, planner="astar-dist", num_threads=1, progress=False
)
SCENARIO = """
[region]
bounds = [-74.0, 40.755, -73.995, 40.759]
resolution_m = 40
altitudes_m = [20]
[buildings]
source = "synthetic"
[gps]
mask_deg = 60
"""
MEASURED = ("elapsed_s", "setup_s", "search")  # columns of tables that no two runs share
RECORDS = ("run.json", "checksums.json")  # which name times, and sums of what was measured
MASKS = ("60", "50")
MINE = b"the user's words"
pytestmark = pytest.mark.usefixtures("blank_pictures")


def maps(folder: Path) -> None:
    main(["maps", "town.toml", "-o", str(folder)])


def rows(folder: Path) -> None:
    how = {"planner": "astar-dist", "num_threads": 1, "progress": False}
    ju.plan_many(MAPS, ENDS, altitude_m=20.0, file=folder / "rows.parquet", **how)


def study(folder: Path) -> None:
    how = ju.studies.Study(planners=("astar-dist", "theta-star"), altitudes_m=(20.0,))
    ju.studies.study("made", folder, 2, settings=how, progress=False)


def routes(folder: Path) -> None:
    how = ju.studies.SensitivitySettings(vary=("gps", "risk"))
    ju.studies.sensitivity("made", folder, 1, settings=how, progress=False)


def compare(folder: Path) -> None:
    main(["compare", "made", "made", "-o", str(folder)])


def exports(folder: Path) -> None:
    PATHS[0].save(*(folder / f"path{suffix}" for suffix in FORMATS))
    for suffix in (".parquet", ".csv", ".geojson", ".kml"):
        PATHS.save(folder / f"paths{suffix}")


def saved(folder: Path) -> None:
    MAPS.save(folder)


SCENES = {job.__name__: job for job in (maps, rows, study, routes, compare, exports, saved)}


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """Return a folder with what the scenes read."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "town.toml").write_text(SCENARIO)
    MAPS.save(folder / "made")
    return folder


@pytest.fixture(autouse=True)
def quick(place, monkeypatch) -> None:
    """What the scenes read is here, rows are kept as they come, and the city of one scenario is made once."""
    tasks, made = pipeline.tasks_of, dict[str, list]()
    monkeypatch.chdir(place)
    monkeypatch.setattr(tables, "SAVE_EVERY_S", 0.0)
    monkeypatch.setattr(
        pipeline,
        "tasks_of",
        lambda scenario, stage: (
            made.get(scenario.to_toml()) or made.setdefault(scenario.to_toml(), tasks(scenario))
        ),
    )


def results(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder, tables without what was measured; but for records, and the user's."""
    found = {
        name: data for name, data in files_of(folder).items() if name not in (*RECORDS, "mine.txt")
    }
    for name in found:
        if name.endswith((".parquet", ".csv")):
            table = (pd.read_csv if name.endswith(".csv") else pd.read_parquet)(folder / name)
            found[name] = table.drop(columns=list(MEASURED), errors="ignore").to_csv().encode()
        if name.endswith(".md"):  # whose next command names a folder beside
            found[name] = found[name].replace(str(folder).encode(), b"FOLDER")
    return found


def sentence_of(job: Callable[[Path], None], folder: Path, capsys) -> str:
    """Return how a job fails, by its error or by what its command prints; nothing where it does not."""
    code = 0
    try:
        job(folder)
    except (InputError, OSError, MemoryError) as error:
        return repr(error)
    except SystemExit as ended:
        code = ended.code
    *_, last = ["", *capsys.readouterr().err.splitlines()]
    assert (code, last.startswith("jaxurban: error: ")) in ((0, False), (2, True)), last
    return last if code else ""


@pytest.fixture(scope="module")
def wanted(place) -> Callable[[str], tuple[list[tuple[str, ...]], dict[str, bytes]]]:
    """What returns of a scene, undisturbed, where its steps are taken, and what it makes."""

    @functools.cache
    def make(scene: str) -> tuple[list[tuple[str, ...]], dict[str, bytes]]:
        (place / scene).mkdir()
        with counted(place / scene, way="full") as steps, contextlib.suppress(SystemExit):
            SCENES[scene](place / scene)
        return steps.places, results(place / scene)

    return make


def disturb(
    place: Path, folder: Path, scene: str, way: str, at: int, wanted: dict[str, bytes], capsys
) -> None:
    """Let a step not come off, look at what is left, and run the same again."""
    job = SCENES[scene]
    folder.mkdir(parents=True)
    mine = {"exports": list(wanted), "compare": [], "routes": []}.get(
        scene, ["mine.txt"]
    )  # where these may be
    for name in mine:
        (folder / name).write_bytes(MINE)
    with counted(folder, at, way) as steps:
        try:
            told = sentence_of(job, folder, capsys)
        except Killed:
            told = "killed"
    assert steps.is_over == (at <= steps.num)
    assert len(told.splitlines()) == (1 if told else 0)
    whole = files_of(place / scene)
    assert all((folder / name).read_bytes() in (MINE, whole.get(name)) for name in mine)
    if way != "killed":
        assert [
            path for path in folder.rglob(f"*{SCRATCH_SUFFIX}") if "maps.zarr" not in path.parts
        ] == []
    assert sentence_of(job, folder, capsys) == ""
    left = list(folder.rglob(f"*{SCRATCH_SUFFIX}"))
    assert not left or (
        way == "killed" and scene in ("rows", "exports")
    )  # a folder of none is not swept
    for path in left:
        path.unlink()
    assert results(folder) == wanted
    assert scene == "exports" or all((folder / name).read_bytes() == MINE for name in mine)


@pytest.mark.parametrize(
    ("scene", "way"),
    [
        pytest.param(
            scene, way, marks=[] if scene == "maps" and col % 2 == 0 else [pytest.mark.slow]
        )
        for scene in SCENES
        for col, way in enumerate(WAYS)
    ],
)
def test_a_step_that_does_not_come_off_loses_nothing(place, tmp_path, scene, way, wanted, capsys):
    """One step, drawn; the slow test tries more."""
    places, made = wanted(scene)
    disturb(
        place,
        tmp_path / "out",
        scene,
        way,
        random.Random(scene + way).randint(1, len(places)),
        made,
        capsys,
    )


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_no_step_that_does_not_come_off_loses_anything(place, tmp_path, scene, wanted, capsys):
    """Each step in all four ways; of a scene of more than 30 one for each way through the code, in one of them."""
    places, made = wanted(scene)
    tried = range(len(places))
    if len(tried) > 30:
        rng = random.Random(scene)
        tried = [
            rng.choice([at for at in tried if places[at] == way_in])
            for way_in in dict.fromkeys(places)
        ]
    assert len(tried) <= 70
    for (turn, at), (number, way) in itertools.product(enumerate(tried), enumerate(WAYS)):
        if len(places) <= 30 or (turn + number) % len(WAYS) == 0:
            disturb(place, tmp_path / f"{at}{way}/out", scene, way, at + 1, made, capsys)


class MapsFolder(RuleBasedStateMachine):
    """A folder that maps are made in, ended, failed, damaged and made anew, against which maps it may hold.

    Attributes:
      may_hold: the masks of the maps that the last runs may have left; "": none.
      is_whole: whether the last run ended well and nothing was damaged since.
      mine: the user's files.
    """

    def __init__(self) -> None:
        super().__init__()
        self.place = tempfile.TemporaryDirectory()
        self.folder = Path(self.place.name, "out")
        self.may_hold, self.is_whole, self.mine = {""}, True, dict[Path, bytes]()

    def teardown(self) -> None:
        self.place.cleanup()

    @rule(
        mask=st.sampled_from(MASKS),
        overwrite=st.booleans(),
        at=st.integers(0, 300),
        way=st.sampled_from(WAYS),
    )
    def make(self, mask: str, overwrite: bool, at: int, way: str) -> None:
        before, error = files_of(self.folder), None
        with counted(self.folder, at, way) as steps:
            try:
                make_maps(self.folder, mask, overwrite)
            except (InputError, OSError, MemoryError, Killed) as caught:
                error = caught
        if error is None:
            self.may_hold, self.is_whole = {mask}, True
            assert {
                name: data for name, data in files_of(self.folder).items() if name in whole(mask)
            } == whole(mask)
        elif steps.is_over:
            self.may_hold, self.is_whole = self.may_hold | {mask}, False
        else:
            assert "or pass --overwrite to replace them" in str(error)
            assert not overwrite
            assert self.may_hold - {"", mask}
            assert files_of(self.folder) == before

    @rule(data=st.data(), damage=st.sampled_from(DAMAGES))
    def damage(self, data: st.DataObject, damage: str) -> None:
        if names := sorted(files_of(self.folder).keys() & whole(MASKS[0]).keys()):
            file = self.folder / data.draw(st.sampled_from(names))
            harm(
                file, "deleted" if file.suffix == ".qml" else damage, random.Random(0)
            )  # changed styles stay
            self.is_whole = False

    @precondition(lambda self: self.folder.exists())
    @rule(
        name=st.sampled_from(
            ("mine.txt", "geotiff/my_gps.tif", "maps.zarr/40m/gps/mine", "maps.zarr/mine")
        )
    )
    def plant(self, name: str) -> None:
        file = self.folder / name
        if file.parent.is_dir():
            file.write_bytes(MINE)
            self.mine[file] = MINE

    @rule()
    def look(self) -> None:
        try:
            found = values_of(self.folder)
        except (InputError, UserWarning):
            assert not self.is_whole or self.may_hold == {""}
        else:
            assert found in [values_of(whole_folder(mask)) for mask in self.may_hold - {""}]

    @invariant()
    def no_file_of_the_users_is_lost(self) -> None:
        assert {file: file.read_bytes() for file in self.mine} == self.mine


def make_maps(folder: Path, mask: str, overwrite: bool = False) -> None:
    made = tomllib.loads(SCENARIO.replace("mask_deg = 60", f"mask_deg = {mask}"))
    pipeline.run_scenario(Scenario.from_dict(made), folder, progress=False, overwrite=overwrite)


@functools.cache
def whole_folder(mask: str) -> Path:
    make_maps(folder := Path("whole", mask).absolute(), mask)
    return folder


@functools.cache
def whole(mask: str) -> dict[str, bytes]:
    return {
        name: data for name, data in files_of(whole_folder(mask)).items() if name not in RECORDS
    }


def no_thread() -> None:
    raise RuntimeError("can't start new thread")  # as Python says it where a stack finds no memory


@pytest.mark.parametrize(
    "takes", [lambda: np.zeros(2**55), lambda: jnp.zeros(2**48).block_until_ready(), no_thread]
)
def test_memory_that_runs_out_is_one_sentence_whoever_notices(tmp_path, monkeypatch, capsys, takes):
    monkeypatch.setattr(pipeline, "tasks_of", lambda *_: takes())
    assert "memory ran out: use a smaller region" in sentence_of(maps, tmp_path / "out", capsys)


@pytest.mark.slow
def test_a_file_of_the_users_alone_among_former_maps_does_not_pass_for_maps(tmp_path):
    """As a run leaves it that replaces other maps and fails before its own are whole."""
    make_maps(tmp_path, MASKS[0])
    mine = tmp_path / "maps.zarr/40m/gps/mine"
    mine.write_bytes(MINE)
    with counted(tmp_path, 105, "memory"), pytest.raises(MemoryError):
        make_maps(tmp_path, MASKS[1], overwrite=True)
    make_maps(tmp_path, MASKS[1])
    assert values_of(tmp_path) == values_of(whole_folder(MASKS[1]))
    assert mine.read_bytes() == MINE


@pytest.mark.slow
@pytest.mark.parametrize("num", [2, 12])
def test_a_folder_of_maps_holds_what_the_last_runs_made_and_the_users_files(num):
    how = settings(
        max_examples=num,
        stateful_step_count=8,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    run_state_machine_as_test(MapsFolder, settings=how)
