"""own_folder: one run of one command, and nobody else's files."""

import pytest

from jaxurban.errors import InputError
from jaxurban.io.folders import own_folder


def write(folder, asked=3, command="tune", text="made", **options):
    with own_folder(folder, command, {"seed": asked}, **options):
        (folder / "figures").mkdir(exist_ok=True)
        (folder / "figures" / f"{asked}.txt").write_text(text)


def test_the_same_run_writes_again_and_another_is_refused(tmp_path):
    write(tmp_path)
    write(tmp_path, text="made again")
    with pytest.raises(InputError, match=r"its seed is 3, now 4.*--overwrite"):
        write(tmp_path, 4)
    with pytest.raises(InputError, match="holds what `jaxurban tune` wrote"):
        write(tmp_path, command="sensitivity", overwrite=True)
    assert (tmp_path / "figures" / "3.txt").read_text() == "made again"
    write(tmp_path, 4, overwrite=True)
    assert [path.name for path in (tmp_path / "figures").iterdir()] == ["4.txt"]


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("name", ["mine.txt", "figures/mine.txt", "figures/3.txt"])
def test_a_file_of_others_is_left_alone(tmp_path, name, overwrite):
    (tmp_path / "figures").mkdir()
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match="is there already, and not from `jaxurban tune`"):
        write(tmp_path, overwrite=overwrite)
    (tmp_path / name).unlink()
    write(tmp_path)
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match="is not as `jaxurban tune` wrote it"):
        write(tmp_path, overwrite=overwrite)
    assert (tmp_path / name).read_text() == "mine"


def test_a_run_that_failed_goes_on_in_its_folder(tmp_path):
    def stop():
        with own_folder(tmp_path, "tune", {"seed": 3}):
            (tmp_path / "state").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop()
    write(tmp_path)
    assert (tmp_path / "state").read_text() == "half"


def test_a_damaged_record_is_told(tmp_path):
    write(tmp_path)
    record = tmp_path / "made.json"
    record.write_text(record.read_text().replace('"seed": 3', '"seed": 4'))
    with pytest.raises(InputError, match=r"made\.json.*cannot be read"):
        write(tmp_path, 4)
