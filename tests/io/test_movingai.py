"""MovingAI's files: written and read back, and the published ones read."""

import numpy as np
import pandas as pd

from jaxurban.report.benchmark import write_map, write_scenarios
from tests.movingai import GridProblem, read_map, read_scenarios


def test_a_map_is_written_north_first_and_read_back(tmp_path):
    is_free = np.array([[True, True, False], [True, False, False]])
    write_map(is_free, tmp_path / "a.map")
    assert (tmp_path / "a.map").read_text() == "type octile\nheight 2\nwidth 3\nmap\n.@@\n..@\n"
    np.testing.assert_array_equal(read_map(tmp_path / "a.map"), is_free)


def test_problems_are_sorted_by_length_and_read_back(tmp_path):
    problems = [GridProblem((0, 0), (1, 2), 9.5), GridProblem((1, 1), (0, 1), 1.0)]
    cells = [(*start, *goal, length) for start, goal, length in problems]
    table = pd.DataFrame(cells, columns=["start_row", "start_col", "goal_row", "goal_col", "length"])
    write_scenarios(table, (2, 3), "a.map", tmp_path / "a.map.scen")
    lines = (tmp_path / "a.map.scen").read_text().splitlines()
    assert lines[0] == "version 1"
    assert lines[1].split("\t") == ["0", "a.map", "3", "2", "1", "0", "1", "1", "1.00000000"]
    assert lines[2].startswith("2\t")
    assert read_scenarios(tmp_path / "a.map.scen") == problems[::-1]
