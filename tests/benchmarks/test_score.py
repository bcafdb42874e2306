"""The board: outside planners' routes and every kind of cheat on a map drawn by hand; bounds against closed forms."""

import csv
import hashlib
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

import jaxurban as ju
from benchmarks import score as judge
from benchmarks.score import MISSING, VALID, make_benchmark, score
from tests.made_maps import made_maps

# North is up; two closed cells touch at a corner. A step of one cell is 1 m and costs 1.
DRAWN = """
......
..#...
...#..
......
......
"""
AROUND = "LINESTRING (2.5 2.5, 2.5 1.5, 4.5 1.5, 4.5 3.5, 3.5 3.5)"  # 6 m, the shortest on the grid
CHEATS = {  # route in the track grid, and what it is refused for
    "LINESTRING (2.5 2.5, 3.5 3.5)": "not free",  # between two closed cells
    "LINESTRING (2.5 2.5, 3.5 2.5, 3.5 3.5)": "not free",  # through a wall
    "LINESTRING (2.5 2.5, 3.5 1.5, 4.5 1.5, 4.5 3.5, 3.5 3.5)": "not free",
    "LINESTRING (2.5 2.5, 2.5 1.5, 3.5 1.5, 4.7 2.5, 4.5 3.5, 3.5 3.5)": "off the grid",
    "LINESTRING (2.5 2.5, 2.5 -1.5, 7.5 -1.5, 7.5 3.5, 3.5 3.5)": "leaves the map",
    "LINESTRING (2.5 2.5, 2.5 1e15, 3.5 3.5)": "leaves the map",
    "LINESTRING (2.6 2.5, 2.5 1.5, 4.5 1.5, 4.5 3.5, 3.5 3.5)": "wrong ends",
    "LINESTRING (2.5 2.5, 4.5 1.5)": "wrong ends",
    "LINESTRING (2.5 2.5, nan nan, 3.5 3.5)": "no line",
    "LINESTRING EMPTY": "no line",
    "POINT (2.5 2.5)": "no line",
    "2.5 2.5, 3.5 3.5": "no line",
    "": "no line",
}


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """Return a bundle written by hand, without jaxurban: the map drawn above, a query of each track and its optimum."""
    folder = tmp_path_factory.mktemp("bench")
    is_free = np.array([[cell == "." for cell in row] for row in reversed(DRAWN.split())])
    costs = np.zeros((2, *is_free.shape), np.float32)
    costs[1, 1, 3] = 1.0  # noise, south of the closed cells: a metre in it is an exposure of 1
    facts = {"resolution_m": 1.0, "reference_length_m": 1.0, "layers": ["gps", "noise"]}
    np.savez(folder / "town.npz", costs=costs, is_free=is_free, **facts)
    ends = {"start_x_m": 2.5, "start_y_m": 2.5, "goal_x_m": 3.5, "goal_y_m": 3.5}
    rows = [
        {"track": track, "query": f"town-{k}", "city": "town"}
        | ends
        | {
            "w_distance": 1,
            "w_gps": 1,
            "w_noise": 0,
            "bound": bound,
            "best": 6,
            "layer": "noise",
            "budget": 0.5,
        }
        for track, bound in (("grid", 6), ("any-angle", 4), ("weights", 6), ("budget", 6))
        for k in range(2)
    ]
    pd.DataFrame(rows).to_csv(folder / "queries.csv", index=False)
    files = ("queries.csv", "town.npz")
    sums = "".join(
        f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in files
    )
    (folder / "CHECKSUMS").write_text(sums)
    return folder


def run(capsys, *arguments: object) -> tuple[int, str]:
    """Return the exit code of the command, and what it prints on stdout, or on stderr where it fails."""
    code = judge.main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return code, printed.err if code else printed.out


def assert_one_sentence(err: str, *words: str) -> None:
    assert err.startswith("error: "), err
    assert len(err.strip().splitlines()) == 1, err
    assert [word for word in words if word not in err] == []


def submitted(folder: Path, *rows: tuple, columns=("track", "query", "route", "cost")) -> Path:
    file = folder / "planner.csv"
    pd.DataFrame(
        [row[: len(columns)] for row in rows], columns=list(columns)[: len(rows[0])]
    ).to_csv(file, index=False)
    return file


@pytest.mark.parametrize(("route", "why"), CHEATS.items())
def test_a_route_that_cheats_is_refused_for_what_it_does(route, why, bench, tmp_path):
    lines, routes = score(
        bench, submitted(tmp_path, ("grid", "town-0", route, 1.0), ("grid", "town-1", AROUND, 6.0))
    )
    assert routes["outcome"].tolist() == [why, VALID]
    (line,) = lines.to_dict("records")
    assert (line["asked"], line["valid"], line["failed"]) == (2, 1, f"1 {why}")
    assert line["gap_worst"] == math.inf  # a failure is not dropped
    assert routes["gap"].tolist() == [math.inf, 0.0]


def test_at_any_angle_a_corner_may_be_cut_but_not_passed_between_two_closed_cells(bench, tmp_path):
    past_one = "LINESTRING (2.5 2.5, 2.8 1.9, 4.2 1.9, 4.2 3.5, 3.5 3.5)"
    file = submitted(
        tmp_path,
        ("any-angle", "town-0", past_one),
        ("any-angle", "town-1", "LINESTRING (2.5 2.5, 3.5 3.5)"),
    )
    _, routes = score(bench, file)
    assert routes["outcome"].tolist() == [VALID, "not free"]
    assert routes["cost"][0] == pytest.approx(math.hypot(0.3, 0.6) + 1.4 + 1.6 + 0.7, rel=1e-12)


def test_a_route_keeps_its_budget_or_is_refused(bench, tmp_path):
    north = "LINESTRING (2.5 2.5, 1.5 2.5, 1.5 4.5, 3.5 4.5, 3.5 3.5)"
    _, routes = score(
        bench, submitted(tmp_path, ("budget", "town-0", AROUND), ("budget", "town-1", north))
    )
    assert routes["outcome"].tolist() == ["over budget", VALID]
    assert routes["gap"].tolist() == [math.inf, 0.0]


def test_a_cost_of_its_own_is_shown_and_not_believed(bench, tmp_path):
    lines, routes = score(
        bench, submitted(tmp_path, ("grid", "town-0", AROUND, 3.0), ("grid", "town-1", AROUND, 6.0))
    )
    assert lines["false_claims"].tolist() == [1]
    assert routes[["claimed_cost", "cost"]].to_numpy().tolist() == [[3.0, 6.0], [6.0, 6.0]]


def test_queries_without_a_row_count_as_missing_where_the_track_is_entered(bench, tmp_path):
    _, routes = score(bench, submitted(tmp_path, ("grid", "town-1", AROUND)))
    assert routes[["track", "outcome"]].to_numpy().tolist() == [["grid", MISSING], ["grid", VALID]]


def test_weights_are_scored_by_the_routes_that_they_plan(bench, tmp_path):
    _, routes = score(bench, submitted(tmp_path, ("weights", "town", "distance=3,gps=9")))
    assert routes["gap"].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("track,query\ngrid,town-0\n", ("no column 'route'",)),
        ("track,query,route\n", ("is empty",)),
        (
            f'track,query,route\ngrid,town-0,"{AROUND}"\ngrid,town-0,"{AROUND}"\n',
            ("town-0", "twice"),
        ),
        (f'track,query,route\ngrid,town-9,"{AROUND}"\n', ("grid town-9", "queries.csv")),
        (f'track,query,route\nfast,town-0,"{AROUND}"\n', ("track", "fast")),
        ("track,query,route\nweights,town,gps=fast\n", ("gps=fast",)),
        ("track,query,route\nweights,town,gps=-1\n", ("gps",)),
        ('track,query,route\nweights,town,"gps=1,gps=2"\n', ("gps", "twice")),
        (
            f'track,query,route,cost\ngrid,town-0,"{AROUND}",cheap\n',
            ("cost", "'cheap'", "give a number"),
        ),
        ("track,query,route\nweights,town,noice=1\n", ("noice", "noise")),
        ("\0\0", ("planner.csv",)),
    ],
)
def test_what_is_no_submission_ends_in_one_sentence_and_writes_nothing(
    content, words, bench, tmp_path, capsys
):
    file = tmp_path / "planner.csv"
    file.write_text(content)
    code, err = run(capsys, bench, file, "-o", tmp_path / "board.csv")
    assert code == 2
    assert_one_sentence(err, *words)
    assert [path.name for path in tmp_path.iterdir()] == ["planner.csv"]


def test_making_leaves_a_file_of_the_user_alone(tmp_path):
    (tmp_path / "town.npz").write_text("mine")
    with pytest.raises(ju.InputError, match=r"town\.npz"):
        make_benchmark(tmp_path, 1, {"town": made_maps(24, 30)})
    assert [file.read_text() for file in tmp_path.iterdir()] == ["mine"]


def test_a_changed_bundle_is_refused(bench, tmp_path, capsys):
    for file in bench.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "queries.csv").write_text((bench / "queries.csv").read_text().replace(",6,", ",9,"))
    code, err = run(capsys, tmp_path, submitted(tmp_path, ("grid", "town-0", AROUND)))
    assert code == 2
    assert_one_sentence(err, "queries.csv", "CHECKSUMS")


def as_bundle(bench, folder, **changed: bytes) -> Path:
    """Copy a bundle with other contents of some files, and checksums of them as they are then."""
    for file in bench.iterdir():
        (folder / file.name).write_bytes(changed.get(file.stem, file.read_bytes()))
    names = [path.name for path in folder.iterdir() if path.name != "CHECKSUMS"]
    sums = "".join(
        f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names
    )
    (folder / "CHECKSUMS").write_text(sums)
    return folder


def test_a_bundle_without_checksums_of_what_it_uses_is_refused(bench, tmp_path):
    route = submitted(tmp_path, ("grid", "town-0", AROUND))
    for turn, sums in enumerate(("", (bench / "CHECKSUMS").read_text().splitlines()[0] + "\n")):
        folder = tmp_path / str(turn)
        folder.mkdir()
        as_bundle(bench, folder)
        (folder / "CHECKSUMS").write_text(sums)
        with pytest.raises(ju.InputError, match="is missing or not as CHECKSUMS has it"):
            score(folder, route)


def test_a_city_outside_of_the_bundle_is_not_read(bench, tmp_path):
    (tmp_path / "town.npz").write_bytes((bench / "town.npz").read_bytes())
    queries = (bench / "queries.csv").read_text().replace(",town,", ",../town,")
    (tmp_path / "bundle").mkdir()
    folder = as_bundle(bench, tmp_path / "bundle", queries=queries.encode())
    with pytest.raises(
        ju.InputError, match=r"\.\./town\.npz' is missing or not as CHECKSUMS has it"
    ):
        score(folder, submitted(tmp_path, ("grid", "town-0", AROUND)))


def test_a_bundle_whose_map_holds_objects_is_refused(bench, tmp_path):
    np.savez(tmp_path / "objects.npz", is_free=np.array([{}], object))
    (tmp_path / "bundle").mkdir()
    folder = as_bundle(bench, tmp_path / "bundle", town=(tmp_path / "objects.npz").read_bytes())
    with pytest.raises(ju.InputError, match=r"town\.npz' cannot be read as a city's map"):
        score(folder, submitted(tmp_path, ("grid", "town-0", AROUND)))


def test_making_over_a_file_of_the_user_is_refused_before_maps_are_made(tmp_path, monkeypatch):
    monkeypatch.setattr(judge, "city_maps", lambda: pytest.fail("the work began"))
    (tmp_path / "README.md").write_text("mine")
    with pytest.raises(ju.InputError, match=r"README\.md"):
        make_benchmark(tmp_path)


def test_a_board_keeps_other_methods_and_replaces_the_lines_of_the_same(bench, tmp_path, capsys):
    table, file = tmp_path / "board.csv", submitted(tmp_path, ("grid", "town-0", AROUND))
    for method in ("first", "second", "first"):
        code, out = run(capsys, bench, file, "-o", table, "--method", method)
        assert code == 0
    head, line = out.strip().splitlines()
    assert dict(zip(head.split()[:5], line.split()[:5], strict=True)) == {
        "method": "first",
        "track": "grid",
        "city": "town",
        "asked": "2",
        "valid": "1",
    }
    file = submitted(tmp_path, ("grid", "town-0", AROUND), ("grid", "town-1", AROUND))
    run(capsys, bench, file, "-o", table, "--method", "first")
    file = submitted(tmp_path, ("weights", "town", "distance=1"))
    run(capsys, bench, file, "-o", table, "--method", "second")
    lines = pd.read_csv(table)[["method", "track", "valid"]].to_numpy().tolist()
    assert lines == [["first", "grid", 2], ["second", "grid", 1], ["second", "weights", 2]]
    table.write_text("mine")
    code, err = run(capsys, bench, file, "-o", table)
    assert code == 2
    assert_one_sentence(err, "board.csv")
    assert table.read_text() == "mine"


@pytest.mark.slow
def test_an_outside_planner_that_reads_the_files_alone_meets_every_bound_of_the_grid(tmp_path):
    maps = {"town": made_maps(24, 30)}
    first, again, _ = (
        make_benchmark(tmp_path / name, 3, maps) for name in ("bench", "again", "again")
    )
    for file in first.parent.glob("[!c]*"):
        assert file.read_bytes() == (again.parent / file.name).read_bytes(), file.name
    with np.load(tmp_path / "bench" / "town.npz") as held:
        costs, is_free, side_m, length_m = (
            held[k] for k in ("costs", "is_free", "resolution_m", "reference_length_m")
        )
        layers = held["layers"].tolist()
    rows = []
    with (tmp_path / "bench" / "queries.csv").open() as file:
        for query in csv.DictReader(file):
            if query["track"] in ("grid", "any-angle"):
                rate = (
                    float(query["w_distance"])
                    + sum(float(query[f"w_{n}"]) * c for n, c in zip(layers, costs, strict=True))
                    / length_m
                )
                start, goal = (
                    [int(float(query[f"{end}_{axis}_m"]) // side_m) for axis in "yx"]
                    for end in ("start", "goal")
                )
                rows.append(
                    (
                        query["track"],
                        query["query"],
                        shortest(rate * side_m, is_free, start, goal, side_m),
                    )
                )
    _, routes = score(first.parent, submitted(tmp_path, *rows))
    assert set(routes["outcome"]) == {VALID}
    gap = routes.groupby("track")["gap"].max()
    assert gap["grid"] == pytest.approx(0, abs=1e-6)  # costs are float32
    assert 0 < gap["any-angle"] < 0.3


def shortest(cost, is_free, start, goal, side_m) -> str:
    """Return the cheapest path by SciPy over steps that cut no corner, as WKT."""
    number, arcs = np.arange(is_free.size).reshape(is_free.shape), []
    for (row, col), is_open in np.ndenumerate(is_free):
        for d_row, d_col in ((0, 1), (1, 0), (1, 1), (1, -1)) if is_open else ():
            to = row + d_row, col + d_col
            is_on = to[0] < is_free.shape[0] and 0 <= to[1] < is_free.shape[1]
            if is_on and is_free[to] and is_free[row, to[1]] and is_free[to[0], col]:
                step = math.hypot(d_row, d_col) * (cost[row, col] + cost[to]) / 2
                arcs.append((number[row, col], number[to], step))
    begin, end, step = np.array(arcs).T
    graph = coo_array(
        (step, (begin.astype(int), end.astype(int))), shape=(is_free.size, is_free.size)
    ).tocsr()
    _, before = dijkstra(
        graph, directed=False, indices=number[tuple(start)], return_predecessors=True
    )
    way = [number[tuple(goal)]]
    while way[-1] != number[tuple(start)]:
        way.append(before[way[-1]])
    points = [
        f"{(node % is_free.shape[1] + 0.5) * side_m} {(node // is_free.shape[1] + 0.5) * side_m}"
        for node in way[::-1]
    ]
    return f"LINESTRING ({', '.join(points)})"
