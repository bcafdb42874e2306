"""The triangle of weights beside the map: what ``jaxurban sensitivity`` wrote, and the routes that it tells of."""

import json

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.io.tables import read_table
from jaxurban.viewer.plans import PlanDefaults
from jaxurban.viewer.study import WeightStudy
from jaxurban.viewer.viewer import Viewer
from tests.cli_runs import run
from tests.made_maps import made_maps

MAPS = made_maps(40, 50, altitudes_m=(20.0,))
FREE = np.argwhere(MAPS.is_free(20.0))
ENDS = [",".join(map(repr, np.round(MAPS.grid.lonlat_of_cell(*FREE[at]), 7).tolist())) for at in (0, -1)]


@pytest.mark.slow
def test_the_route_of_each_cell_costs_what_the_study_says(tmp_path, capsys):
    MAPS.save(tmp_path / "maps")
    ends = ("--start", ENDS[0], "--goal", ENDS[1], "--altitude", 20)
    code, _, err = run(
        capsys, "sensitivity", tmp_path / "maps", *ends, "--samples", 2, "--tolerance", 0.01, "-o", tmp_path / "study"
    )
    assert code == 0, err
    study = WeightStudy.read(tmp_path / "study")
    viewer = Viewer(MAPS, study=study, defaults=PlanDefaults())
    told = json.loads(viewer.answer("study", {}).body)
    cells = read_table(tmp_path / "study/tables/triangle_cells.csv", "cells")
    assert np.allclose(cells[list(study.names)].sum(axis=1), 1)
    assert len(told["cells"]) == told["svg"].count("<polygon") == cells.route.nunique() > 3
    lengths = study.routes.set_index("route").length_m
    fields = told["fields"]
    for number, cell in enumerate(told["cells"], start=1):
        query = {
            **told["ends"],
            "at": [fields[name] for name in ("altitude", "time", "time_of_day")],
            "weights": cell["weights"],
            **{name: fields[name] for name in ("cost_model", "obstacles", "clearance_m", "snap")},
        }
        found = json.loads(viewer.answer("plan", query).body)
        assert sum(found["cost_by_layer"].values()) == pytest.approx(found["cost"])
        near = found["cost_by_layer"]["distance"] / cell["weights"]["distance"]
        assert near == pytest.approx(lengths[number], rel=0.1)


def test_a_folder_without_a_study_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no study"):
        WeightStudy.read(tmp_path)
