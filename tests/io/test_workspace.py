"""Workspace: what a command wrote, what it may remove, and whose all else is."""

import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress

import pytest

from jaxurban.errors import InputError
from jaxurban.io import files, workspace
from jaxurban.io.workspace import Workspace, recorded
from tests.faulty_disk import Killed, counted
from tests.logs import logged


def write(folder, asked=3, command="tune", text="made", name=None, **options):
    with Workspace.open(folder, command, {"seed": asked}, **options):
        files.write_whole(folder / (name or f"figures/{asked}.txt"), text)


def refused(match, *where, **options):
    with pytest.raises(InputError, match=match):
        write(*where, **options)


def names_of(folder):
    return sorted(
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()
    )


def test_the_same_run_writes_again_and_another_is_refused(tmp_path):
    write(tmp_path)
    Workspace.check(tmp_path, "tune")  # leaves the settings that the record holds
    write(tmp_path, text="made again")
    refused(r"its seed is 3, now 4.*--overwrite", tmp_path, 4)
    refused("holds what `jaxurban tune` wrote", tmp_path, command="sensitivity", overwrite=True)
    assert (tmp_path / "figures" / "3.txt").read_text() == "made again"
    write(tmp_path, 4, overwrite=True)
    assert names_of(tmp_path) == ["checksums.json", "figures/4.txt"]


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("name", ["mine.txt", "figures/mine.txt", "figures/3.txt"])
def test_a_folder_of_others_is_refused(tmp_path, name, overwrite):
    (tmp_path / "figures").mkdir()
    (tmp_path / name).write_text("mine")
    refused("is there already, and not from `jaxurban tune`", tmp_path, overwrite=overwrite)
    assert names_of(tmp_path) == [name]


def test_damaged_lines_of_the_journal_are_passed_over(tmp_path):
    write(tmp_path)
    lines = (
        "5",
        "[1]",
        '{"commanc": "tune"}',
        '{"command": "tune", "name": "figures/3.txt"}',
        '{"name": "x"}',
    )
    (tmp_path / ".checksums.jsonl").write_text("\n".join(lines))
    assert recorded(tmp_path).keys() == {"figures/3.txt"}
    write(tmp_path, text="made again")
    assert names_of(tmp_path) == ["checksums.json", "figures/3.txt"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_changed_file_is_refused_and_a_new_one_stays(tmp_path, overwrite):
    write(tmp_path)
    (tmp_path / "figures" / "mine.txt").write_text("made")  # a copy
    with logged() as told:
        write(tmp_path, overwrite=overwrite)
    assert [("mine.txt" in line and "stay" in line) for line in told] == [True] * overwrite
    (tmp_path / "figures" / "3.txt").write_text("mine")
    refused("is not as `jaxurban tune` wrote it", tmp_path, overwrite=overwrite)
    assert names_of(tmp_path) == ["checksums.json", "figures/3.txt", "figures/mine.txt"]
    assert (tmp_path / "figures" / "3.txt").read_text() == "mine"


def test_a_file_that_comes_during_the_run_is_not_taken_for_its_own(tmp_path):
    with Workspace.open(tmp_path, "tune"):
        files.write_whole(tmp_path / "a.txt", "made")
        (tmp_path / "mine.txt").write_text("mine")
        (tmp_path / "b.txt").write_text("mine")
        (tmp_path / "a.txt").write_text("edited")
        with pytest.raises(InputError, match=r"b\.txt' is in the way"):
            files.write_whole(tmp_path / "b.txt", "made")
    refused(r"a\.txt' is in the way", tmp_path, overwrite=True)
    assert [(tmp_path / name).read_text() for name in ("a.txt", "mine.txt", "b.txt")] == [
        "edited",
        "mine",
        "mine",
    ]


def test_after_a_kill_a_users_file_is_the_users_and_scratch_goes(tmp_path):
    with (
        suppress(Killed, InputError),
        counted(tmp_path, 14),  # the second file's coming into place
        Workspace.open(tmp_path, "tune", {"seed": 3}),
    ):
        for name in ("a", "b"):
            files.write_whole(tmp_path / f"figures/{name}.txt", "made")
    assert len([name for name in names_of(tmp_path) if name.endswith(files.SCRATCH_SUFFIX)]) == 1
    (tmp_path / "figures" / "mine.txt").write_text("mine")
    for overwrite, kept in ((False, ["figures/a.txt"]), (True, [])):
        write(tmp_path, overwrite=overwrite)
        assert names_of(tmp_path) == ["checksums.json", "figures/3.txt", *kept, "figures/mine.txt"]
    assert (tmp_path / "figures" / "mine.txt").read_text() == "mine"


def test_a_kill_between_the_record_and_the_file_leaves_the_old_file_known(tmp_path):
    """Or at any other step."""
    for at in range(1, 12):
        write(tmp_path, text=f"newest {at}")
        with suppress(Killed, InputError, OSError), counted(tmp_path, at) as steps:
            write(tmp_path, text="newer")
        assert steps.is_over
    write(tmp_path, text="newest")
    assert (tmp_path / "figures" / "3.txt").read_text() == "newest"


def test_a_run_that_was_refused_leaves_nothing(tmp_path):
    def refuse(folder):
        with Workspace.open(folder, "tune"):
            raise InputError("no such weight")

    for folder in (tmp_path / "new", tmp_path):
        with pytest.raises(InputError, match="no such weight"):
            refuse(folder)
    assert not list(tmp_path.iterdir())


def test_commands_share_a_folder_and_remove_their_own(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    for command in ("maps", "demo"):
        write(tmp_path, command=command, name=f"{command}.txt", is_shared=True)
    write(tmp_path, 4, command="maps", name="new.txt", is_shared=True, overwrite=True)
    assert names_of(tmp_path) == ["checksums.json", "demo.txt", "mine.txt", "new.txt"]
    refused("in the way", tmp_path, 4, command="maps", name="mine.txt", is_shared=True)


@pytest.mark.parametrize("text", ["made", "mine"])
def test_a_link_in_the_place_of_a_file_is_followed_nowhere(tmp_path, text):
    """Not to a copy of the output either."""
    write(tmp_path / "out")
    (tmp_path / "mine.txt").write_text(text)
    (tmp_path / "out/figures/3.txt").unlink()
    (tmp_path / "out/figures/3.txt").symlink_to(tmp_path / "mine.txt")
    refused("in the way", tmp_path / "out", 4, overwrite=True)
    assert (tmp_path / "out/figures/3.txt").is_symlink()
    assert (tmp_path / "mine.txt").read_text() == text


@pytest.mark.parametrize("text", ["{", '{"command": "tune", "settings": {}, "written": {}}'])
def test_a_damaged_record_is_told(tmp_path, text):
    write(tmp_path)
    (tmp_path / "checksums.json").write_text(text)
    refused(r"checksums\.json.*cannot be read", tmp_path, 4, overwrite=True)


OUTSIDE = [
    "",
    ".",
    "..",
    "../mine.txt",
    "figures/../../mine.txt",
    "MINE",
    "..\\mine.txt",
    "C:\\mine.txt",
    "\\mine.txt",
    "a\0b",
    "\ud800",
]


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_record_or_a_journal_that_names_what_is_not_under_the_folder_is_refused(tmp_path, name):
    """And nothing is removed: beside an empty name the record holds the checksum of the file that was to go."""
    write(tmp_path / "out")
    mine = tmp_path / "mine.txt"
    mine.write_text("made")
    name = str(mine) if name == "MINE" else name
    record = files.read_json(tmp_path / "out/checksums.json")
    journal = tmp_path / "out/.checksums.jsonl"
    for line in ({"scratch": name}, {"command": "tune", "name": name, "checksum": None}):
        journal.write_text(json.dumps(line))
        refused(r"checksums\.jsonl.*is not under the folder.*-o", tmp_path / "out", is_shared=True)
    journal.unlink()
    record["tune"]["written"] |= {
        name: files.checksum_of(b"made"),
        str(mine): files.checksum_of(b"made"),
    }
    files.write_json(tmp_path / "out/checksums.json", record)
    for options in ({"overwrite": True, "is_shared": True}, {}):
        refused(r"checksums\.json.*is not under the folder.*-o", tmp_path / "out", 4, **options)
    with pytest.raises(InputError, match="is not under the folder"):
        recorded(tmp_path / "out")
    assert mine.read_text() == "made"


@pytest.mark.parametrize(
    "text",
    [
        "[1]",
        '{"tune": 5}',
        '{"tune": {"settings": {}, "written": ["a"]}}',
        f'{{"tune": {"[" * 200_000}',
    ],
)
def test_a_record_of_another_form_is_one_sentence(tmp_path, text):
    data = text.replace("{", f'{{"checksum": "{files.BLANK.decode()}", ', 1).encode()
    (tmp_path / "checksums.json").write_bytes(files.sealed(data))
    refused(r"checksums\.json.*cannot be read", tmp_path)


def test_scratch_that_a_journal_names_goes_unless_it_is_no_scratch_or_behind_a_link(tmp_path):
    write(tmp_path / "out")
    scrap, work = ".a.txt.0a1b2c3d.jaxurban-part", "maps.zarr/.5m.jaxurban-part"
    for name in (scrap, work, f"figures/{scrap}"):
        (tmp_path / "out" / name / "deep").mkdir(parents=True)
    (tmp_path / "elsewhere" / scrap).mkdir(parents=True)
    (tmp_path / "out/link").symlink_to(tmp_path / "elsewhere")
    names = (scrap, work, f"figures/{scrap}", f"link/{scrap}", "figures")
    (tmp_path / "out/.checksums.jsonl").write_text(
        "\n".join(json.dumps({"scratch": name}) for name in names)
    )
    write(tmp_path / "out", is_shared=True)
    there = [(tmp_path / "out" / name).exists() for name in names]
    assert there == [False, True, False, True, True]


@pytest.mark.parametrize(
    "name", [".checksums.jsonl", ".jaxurban.lock", "kept", "figures", "checksums.json"]
)
@pytest.mark.parametrize("is_there", [False, True])
def test_nothing_is_written_through_a_link_in_the_folder(tmp_path, name, is_there):
    """The target of a link is the user's file or folder, or is not there."""
    write(tmp_path / "out")
    (tmp_path / "out/figures/3.txt").write_text("edited")
    target, is_folder = tmp_path / "target", name in ("kept", "figures")
    if is_there:
        target.mkdir() if is_folder else target.write_text("mine")
    if (tmp_path / "out" / name).exists():
        (tmp_path / "out" / name).rename(tmp_path / "moved")
    (tmp_path / "out" / name).symlink_to(target)
    with suppress(InputError):
        write(tmp_path / "out", is_shared=True, is_mended=True)
    with suppress(InputError):
        write(tmp_path / "out", 4, overwrite=True, is_shared=True)
    assert target.exists() == is_there
    if is_there:
        assert not list(target.iterdir()) if is_folder else target.read_text() == "mine"


def test_a_run_that_ends_just_before_another_one_begins_to_write_is_not_replaced(
    tmp_path, monkeypatch
):
    """Unless that is asked for, or nothing of it is left."""
    hold = workspace.only_writer

    @contextmanager
    def after_a_rival(folder, *remedy):
        monkeypatch.setattr(workspace, "only_writer", hold)
        write(folder, 4)
        with hold(folder, *remedy):
            yield

    monkeypatch.setattr(workspace, "only_writer", after_a_rival)
    refused(r"its seed is 4, now 3.*--overwrite", tmp_path, is_shared=True, is_mended=True)
    assert names_of(tmp_path) == ["checksums.json", "figures/4.txt"]
    write(tmp_path, 4, overwrite=True, is_mended=True, name="more.txt")
    assert names_of(tmp_path) == [
        "checksums.json",
        "figures/4.txt",
        "more.txt",
    ]  # the same run goes on
    for name in ("figures/4.txt", "more.txt"):
        (tmp_path / name).unlink()
    write(tmp_path, is_shared=True)
    assert names_of(tmp_path) == ["checksums.json", "figures/3.txt"]


def test_files_behind_a_linked_folder_are_the_users(tmp_path):
    out, copies, text = tmp_path / "out", tmp_path / "copies", "figures/3.txt"
    for shared in (False, True):
        write(out)
        (out / "figures").rename(copies)
        (out / "figures").symlink_to(copies)
        sentence = r"figures' is a link in the way of a folder"
        refused(sentence, out, 4, name="figures/new.txt", overwrite=True, is_shared=shared)
        with (
            pytest.raises(InputError, match="in the way"),
            Workspace.open(out, "maps", is_shared=True, is_mended=True),
        ):
            files.write_whole(out / text, "made again")
        assert names_of(copies) == ["3.txt"]
        (out / "figures").unlink()
        copies.rename(out / "figures")


def test_a_linked_output_folder_is_as_good_as_any(tmp_path):
    (tmp_path / "real/place").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write(tmp_path / "link/place")
    write(tmp_path / "link/place", 4, overwrite=True)
    assert names_of(tmp_path / "real/place") == ["checksums.json", "figures/4.txt"]


def test_a_resolved_path_into_a_linked_folder_of_a_linked_output_folder_is_recorded(tmp_path):
    for name in ("real", "disk"):
        (tmp_path / name).mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "real")
    (tmp_path / "real/geotiff").symlink_to(tmp_path / "disk")
    (tmp_path / "disk/gps.tif").write_text("mine")
    with (
        Workspace.open(tmp_path / "out", "maps", is_shared=True),
        pytest.raises(InputError, match="in the way"),
    ):
        files.write_whole((tmp_path / "out").resolve() / "geotiff/gps.tif", "made")
    assert (tmp_path / "disk/gps.tif").read_text() == "mine"


def test_a_users_file_of_just_the_bytes_to_be_written_stays_the_users(tmp_path):
    (tmp_path / "a.txt").write_text("made")
    write(tmp_path, name="a.txt", is_shared=True)
    assert names_of(tmp_path) == ["a.txt"]
    refused(r"a\.txt' is in the way", tmp_path, name="a.txt", text="newer", is_shared=True)
    assert (tmp_path / "a.txt").read_text() == "made"


def test_a_folder_that_cannot_be_put_in_place_removes_nothing_of_the_older_one(tmp_path):
    def put(names):
        with files.scratch_for(tmp_path / "out/20m") as made:
            for name in names:
                files.write_whole(made / name, "made")
            workspace.put_folder(
                made,
                tmp_path / "out/20m",
                dict.fromkeys(names, files.checksum_of(b"made")),
                names[0],
            )

    with Workspace.open(tmp_path / "out", "maps", is_shared=True) as workspace:
        put(["meta", "gps/0"])
        (tmp_path / "out/20m/risk").write_text("mine")
        with pytest.raises(InputError, match=r"risk' is a file in the way"):
            put(["meta", "gps/0", "risk/0"])
    assert names_of(tmp_path / "out/20m") == ["gps/0", "meta", "risk"]


def test_pictures_and_tables_from_python_replace_none_of_the_users(tmp_path):
    def save(text):
        with Workspace.shared(tmp_path, "maps --figures", ["gps.png"]):
            files.write_whole(tmp_path / "gps.png", text)

    for text in ("made", "newer"):
        save(text)
    (tmp_path / "gps.png").write_text("mine")
    with pytest.raises(InputError, match=r"gps\.png' is in the way"):
        save("newest")
    with Workspace.open(tmp_path, "demo", is_shared=True) as workspace:
        with Workspace.shared(tmp_path / "figures", "maps --figures", ["gps.png"]):
            files.write_whole(tmp_path / "figures/gps.png", "made")
        assert list(workspace.written) == ["figures/gps.png"]


@pytest.mark.parametrize("kind", ["file", "link to nowhere"])
def test_a_check_refuses_what_is_in_the_place_of_the_folder(tmp_path, kind):
    folder = tmp_path / "analysis"
    folder.write_text("mine") if kind == "file" else folder.symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"cannot write to the output folder .*analysis"):
        Workspace.check(folder, "study")


def test_a_record_that_the_user_replaced_during_the_run_is_kept(tmp_path):
    with Workspace.open(tmp_path, "tune"):
        (tmp_path / "checksums.json").write_text("mine")
        files.write_whole(tmp_path / "a.txt", "made")
    assert (tmp_path / "checksums.json.2").read_text() == "mine"
    assert list(files.read_json(tmp_path / "checksums.json")["tune"]["written"]) == ["a.txt"]


def test_a_folder_is_held_while_a_study_works_and_gone_where_it_wrote_nothing(tmp_path):
    out = tmp_path / "out"
    with Workspace.held(out, "validate"), Workspace.held(tmp_path / "other", "validate"):
        with ThreadPoolExecutor() as pool:  # another thread is another run, as another process is
            refused = pool.submit(Workspace.check, out, "validate").exception()
        assert "another run is writing" in str(refused)
        with Workspace.open(out, "validate", {"a": 1}, names=["report.md"]):
            files.write_whole(out / "report.md", "words")
    assert [path.name for path in sorted(out.iterdir())] == ["checksums.json", "report.md"]
    with pytest.raises(ZeroDivisionError), Workspace.held(tmp_path / "none", "validate"):
        1 / 0  # noqa: B018
    assert not (tmp_path / "none").exists()
