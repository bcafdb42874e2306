"""Each set of names that type checkers see holds the names of the table that it stands for, and no others."""

from typing import get_args

import pytest

from jaxurban.flights.export.qgc_plan import END_NOTES
from jaxurban.io.samples import SAMPLES
from jaxurban.planners.registry import PLANNERS, VOLUME_PLANNERS
from jaxurban.settings import (
    PRESETS,
    HeuristicName,
    MissionEnd,
    PlannerName,
    Preset,
    SampleName,
)
from jaxurban.world.footprints import UNKNOWN
from jaxurban.world.kinds import EFFECTS, KindName

ALL_PLANNERS = PLANNERS | VOLUME_PLANNERS
HEURISTICS = {name for entry in ALL_PLANNERS.values() for name in entry.heuristics}


@pytest.mark.parametrize(
    ("names", "table"),
    [
        (PlannerName, ALL_PLANNERS),
        (HeuristicName, HEURISTICS),
        (MissionEnd, END_NOTES),
        (SampleName, SAMPLES),
        (Preset, PRESETS),
        (KindName, {*EFFECTS} - {UNKNOWN}),
    ],
)
def test_names_are_those_of_their_table(names, table):
    assert {*get_args(names)} == {*table}
