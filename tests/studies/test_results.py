"""A study as a value of a notebook: units of its tables, its pictures alone and in another figure, no folder."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

import jaxurban as ju
from jaxurban.studies.results import UNITS, StudyResult
from jaxurban.typing import Sensitivity
from tests.pictures import faults

# Names that say what they count or are, and those that end in a unit.
PLAIN = (
    r"(.*_)?(routes?|pairs|cities|draws?|groups|instance|n|needed|cells|num_\w+|at_edge|expanded|"
    r"samples|joined|paths|runs|crashed)"
)
WITH_UNIT = (
    r".*_(m|s|percent)(_change)?|(mean|m)_\w+|people|cost|higher|lower|lost|gained|rank|behind"
)


def without_unit(tables: dict[str, pd.DataFrame]) -> list[str]:
    """Return the columns of numbers that have no unit, neither in their name nor in the table's attributes."""
    missing = []
    for name, table in tables.items():
        assert table.attrs["units"] == UNITS
        for column in table.select_dtypes("number"):
            stem = re.sub("_(low|high)$", "", str(column).partition(":")[0])
            is_ratio = stem in ("low", "high", "mean", "rms", "from", "to")
            if (
                stem not in UNITS
                and not re.fullmatch(f"{PLAIN}|{WITH_UNIT}", stem)
                and not is_ratio
            ):
                missing.append(f"{name}: {column}")
    return missing


@pytest.fixture(scope="module")
def in_memory(crossed, ends) -> Sensitivity:
    return ju.studies.sensitivity(crossed, routes=[ends], altitudes_m=[20.0], progress=False)


@pytest.mark.slow
def test_a_study_without_a_folder_is_the_same_and_is_kept_when_it_is_saved(
    in_memory, crossed, ends, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    kept = ju.studies.sensitivity(crossed, "kept", [ends], altitudes_m=[20.0], progress=False)
    assert (in_memory.folder, kept.folder) == (None, Path("kept"))
    for name, table in kept.tables.items():
        other = in_memory.tables[name]
        pd.testing.assert_frame_equal(
            table.drop(columns="elapsed_s", errors="ignore"),
            other.drop(columns="elapsed_s", errors="ignore"),
        )
    assert [*Path().iterdir()] == [Path("kept")]
    assert in_memory.decided.facts["decided"] == kept.decided.facts["decided"]
    assert (in_memory.save("later")[-1]).read_text().startswith("# Which weights matter")
    assert Path("later/figures/switch_routes.png").exists()
    kept.save("kept")  # the same study
    turned = ju.studies.sensitivity(
        crossed, routes=[ends[::-1]], altitudes_m=[20.0], progress=False
    )
    before = Path("kept/report.md").read_bytes()
    with pytest.raises(ju.InputError, match="holds another run of `jaxurban sensitivity`"):
        turned.save("kept")
    assert Path("kept/report.md").read_bytes() == before
    turned.save("kept", overwrite=True)


@pytest.mark.slow
def test_a_benchmark_that_is_saved_replaces_none_of_other_settings(study, tmp_path):
    study.save(tmp_path / "kept")
    chosen = replace(study.settings, study=replace(study.settings.study, seed=77))
    other = replace(study, settings=chosen)
    with pytest.raises(ju.InputError, match="its seed is"):
        other.save(tmp_path / "kept")
    study.save(tmp_path / "kept")


@pytest.mark.slow
def test_tables_have_units_and_pictures_show_themselves_and_fill_a_cell_of_another_figure(
    in_memory, weight_study, study, crossed
):
    other = ju.MetricMaps(crossed.ds.assign(risk=1 - crossed.ds["risk"]))
    change = ju.studies.compare(crossed, other, progress=False)
    results: dict[str, StudyResult] = {
        "switch_routes": in_memory,
        "regret": weight_study,
        "costs": study,
        "risk": change,
    }
    page = Figure(figsize=(20.0, 18.0), layout="constrained")
    for (name, result), ax in zip(results.items(), page.subplots(2, 2).ravel(), strict=True):
        assert without_unit(result.tables) == []
        assert "decided" in result.decided._repr_html_()
        picture = result.plot(name)
        assert picture._repr_png_().startswith(b"\x89PNG")
        part = result.plot(name, ax=ax)
        assert part.get_suptitle().replace("\n", " ") == picture.get_suptitle().replace("\n", " ")
        assert len(part.axes) == len(picture.axes)
        drawn = [np.size(image.get_array()) for image in part.findobj(AxesImage)]
        assert drawn == [np.size(image.get_array()) for image in picture.findobj(AxesImage)]
        with pytest.raises(
            ju.InputError, match="has no picture 'none': name one of the study's own"
        ):
            result.plot("none")
    assert len(page.subfigs) == 4
    assert len(page.axes) == sum(len(part.axes) for part in page.subfigs)
    assert faults(page) == []


@pytest.mark.parametrize(
    ("names", "what"),
    [
        (["study"], "by bootstrap over instances, of which *n* count"),
        (
            ["sensitivity", "intervals"],
            "by bootstrap over pairs of places, as many as the first table says",
        ),
        (["compare"], "by bootstrap over the {pairs} pairs of places"),
        (["targets"], "by bootstrap over the *n* pairs of ends"),
        (["imitation", "held_out"], "by bootstrap over {fit.num_tested} pairs of ends"),
    ],
)
def test_each_report_says_once_what_its_intervals_are(names, what):
    templates = Path(ju.__file__).parent / "studies" / "templates"
    text = "".join((templates / f"{name}.md").read_text() for name in names)
    assert text.count("95 %") == text.count(what) == 1
    assert re.search("each for itself|at once", text)


def test_a_picture_fills_only_a_cell_of_a_grid():
    summary = pd.DataFrame({"cut": ["all"], "value": "all", "weight_name": "gps", "regret": 0.1})
    summary = summary.assign(regret_low=0.05, regret_high=0.2)
    with pytest.raises(ju.InputError, match="ax must be one cell of a grid of axes"):
        ju.plot.plot_regret(summary, 2.0, ax=Figure().add_axes((0, 0, 1, 1)))
