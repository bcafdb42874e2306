"""What studies refuse: each in one sentence that names what is wrong, and nothing is written."""

import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.fit import FitSettings, Target, fit_targets, fit_weights
from jaxurban.io.tables import write_table
from jaxurban.studies.montecarlo.sampling import read_instances, sample_instances
from jaxurban.studies.queries import RouteQuery, check_alike
from jaxurban.studies.weights.routes import varied_columns
from tests.made_maps import made_maps
from tests.studies.routes_made import (
    STUDY,
    WEIGHT_STUDY,
    made_queries,
    run_study,
    small_maps,
    walled,
    write_lines,
)


class Scene:
    """Fixtures by their names, made when a row asks for one."""

    def __init__(self, request) -> None:
        self._request = request

    def __getattr__(self, name: str):
        return self._request.getfixturevalue(name)


def of_file(
    s: Scene, change=lambda table: table, name: str = "instances.csv", **columns
) -> pd.DataFrame:
    """Read two of the study's instances, changed, from a file."""
    return read_instances(
        write_table(change(s.study.instances[:2].assign(**columns)), s.tmp_path / name)
    )


def study(s: Scene, instances: object = 1, **change):
    return run_study(
        "study", s.folders, s.tmp_path / "out", instances, settings=replace(STUDY, **change)
    )


def other(s: Scene, **columns):
    return study(s, s.study.instances.assign(**columns))


def into(s: Scene, instances: object = 12, **change):
    """Run another study into the folder of one."""
    return run_study(
        "study", s.folders, s.study.folder, instances, settings=replace(STUDY, **change)
    )


def drawn(s: Scene, **arguments) -> pd.DataFrame:
    return sample_instances(s.alpha, **{"num": 12, "seed": 2} | arguments)


def noisy(s: Scene, change):
    instances = change(sample_instances(s.noisy, 1, seed=3))
    return ju.studies.study(s.noisy, s.tmp_path / "out", instances, settings=STUDY, progress=False)


def weights(s: Scene, routes: object):
    return run_study("weight_study", s.folders, s.tmp_path / "out", routes, settings=WEIGHT_STUDY)


def reweighed(s: Scene, *num: int, **how):
    """Run another study of weights into the folder of one."""
    return run_study("weight_study", s.folders, s.weight_study.folder, *num, **how)


def cities(s: Scene, *names: str):
    return weights(s, s.weight_study.instances.iloc[: len(names)].assign(city=[*names]))


def routes(s: Scene, *lines_m, **how):
    """Read lines of routes from a file."""
    file = write_lines(s.tmp_path / "lines.geojson", s.small, *lines_m, **how.pop("properties", {}))
    return ju.fit.demonstrations(file, s.small, **how)


def shown(s: Scene, **properties):
    at, grid = s.demonstrations[0], s.small.grid
    return routes(s, at.points_m + np.array([grid.x_min_m, grid.y_min_m]), properties=properties)


def inside(s: Scene):
    """Read a line that starts far inside an obstacle."""
    maps = small_maps()
    for name, value in (("roof", 99.0), ("roof_touched", 99.0), ("obstacle", 1)):
        maps.ds[name][..., 5:25, 5:25] = value
    line_m = [maps.grid.xy_of_cell(*cell) for cell in ((15, 15), (33, 30))]
    return ju.fit.demonstrations(
        write_lines(s.tmp_path / "a.geojson", maps, line_m), maps, altitude_m=20.0
    )


def alike(*norms: list[float], by: str = "city"):
    """Check queries of maps whose population is normalised by other numbers, by city or by time of day."""
    made = [small_maps() for _ in norms]
    for maps, norm in zip(made, norms, strict=True):
        maps.ds.attrs["pop_norm_per_km2"] = norm
    times = made[0].times_of_day if by == "time" else (None,)
    check_alike(
        [
            RouteQuery(ju.cost_map(m, 20.0, time_of_day=t), (1, 1), (20, 20))
            for m in made
            for t in times
        ]
    )


def targets(s: Scene, *given):
    unit = ju.cost_map(s.small, 20.0).only(("gps", "lidar"))
    return fit_targets(made_queries(unit, 2), list(given))


def fitted(s: Scene, **how):
    return fit_weights(s.demonstrations[:4], **how)


def sensitivity(s: Scene, maps=None, goal: int = 1, **how):
    ends = s.ends[0], s.ends[goal]
    return ju.studies.sensitivity(maps or s.crossed, "out", [ends], altitudes_m=[20.0], **how)


def compare(s: Scene, change):
    return ju.studies.compare(s.alpha, ju.MetricMaps(change(s.alpha.ds)), progress=False)


FAR = [(1e7, 4.5e6), (1.001e7, 4.5e6)]
ROWS = [
    ("at least one Weights", lambda s: drawn(s, weights=[])),
    ("33", lambda s: drawn(s, altitudes_m=[33])),
    ("none twice, got 60, 60", lambda s: drawn(s, altitudes_m=[60, 60])),
    ("none", lambda s: drawn(s, altitudes_m=[])),
    ("fewer than two cells", lambda s: sample_instances(walled(s.crossed), 1)),
    (
        "instances.csv.*lacks.*w_gps",
        lambda s: of_file(s, lambda table: table.drop(columns="w_gps")),
    ),
    ("instances.csv.*row 1.*w_gps.*>= 0.*-1.0", lambda s: of_file(s, w_gps=-1.0)),
    (r"instances.csv.*row 1.*w_gps.*at most 9e\+18.*1e\+308", lambda s: of_file(s, w_gps=1e308)),
    ("instances.csv.*row 2.*got nan", lambda s: of_file(s, w_gps=[1.0, None])),
    ("instances.csv.*whole number", lambda s: of_file(s, instance=0.5)),
    ("instances.csv.*start_x_m.*west", lambda s: of_file(s, start_x_m="west")),
    (
        "instances.csv.*instance 0 at 20 m twice",
        lambda s: of_file(s, lambda table: pd.concat([table, table])),
    ),
    ("instances.csv.*no row", lambda s: of_file(s, lambda table: table[:0])),
    ("lacks the column", lambda s: read_instances(shutil.copy(__file__, s.tmp_path / "a.parquet"))),
    ("does not exist", lambda s: read_instances(s.tmp_path / "b.csv")),
    ("does not exist", lambda _: read_instances("c.txt")),
    (
        r"lists\.parquet.*'crs' holds lists",
        lambda s: of_file(s, name="lists.parquet", crs=[["EPSG:32618"]] * 2),
    ),
    ("save them", lambda s: ju.studies.study(s.alpha, s.tmp_path / "out", 1, workers=2)),
    ("instance 0 at 20 m, the start or the goal is not free", lambda s: other(s, start_x_m=0.0)),
    ("row 1: instance must be a whole number >= 0, got -3", lambda s: other(s, instance=-3)),
    ("EPSG:25830", lambda s: other(s, crs="EPSG:25830")),
    ("altitude_m 33", lambda s: other(s, altitude_m=s.study.instances.altitude_m + 13.0)),
    ("dusk", lambda s: other(s, time_of_day="dusk")),
    ("its budget is 200 samples, now 2.0 s", lambda s: into(s, budget_iterations=None)),
    (
        "are others or left out now .instance 0 at 20 m is the first",
        lambda s: into(s, drawn(s, weights=[ju.Weights()])),
    ),
    (
        "of 24 instances.* 2 are others or left out now .*longer but not shorter",
        lambda s: into(s, 11),
    ),
    ("no weight 'w_noise'", lambda s: noisy(s, lambda table: table.drop(columns="w_noise"))),
    ("or 'noise', got 'nois'", lambda s: noisy(s, lambda table: table.assign(w_nois=1.0))),
    (
        r"name the cities alpha, gamma \(column 'city'\), and the maps are of alpha, beta",
        lambda s: cities(s, "alpha", "gamma"),
    ),
    (
        r"name the cities alpha \(column 'city'\), and the maps are of alpha, beta",
        lambda s: cities(s, "alpha", "alpha"),
    ),
    ("routes must be", lambda s: weights(s, True)),
    ("name the cities none", lambda s: weights(s, [((0.0, 0.0), (1, 1))])),
    ("name the cities none", lambda s: weights(s, s.weight_study.instances[:0])),
    (
        "another run of `jaxurban sensitivity`",
        lambda s: reweighed(s, settings=replace(WEIGHT_STUDY, wrong=3.0)),
    ),
    ("another run of `jaxurban sensitivity`", lambda s: reweighed(s, 1)),
    (
        r"its weights.gps is 1.0, now 2.0; its weights.risk is 1.0, now 0.5\)",
        lambda s: reweighed(s, weights={"gps": 2.0, "risk": 0.5}),
    ),
    ("factors must be two", lambda _: ju.studies.SensitivitySettings(factors=(0.1,))),
    ("nothing varies", lambda _: varied_columns(("distance", "gps"), np.array([0.1, 0.0]), ())),
    (
        "or 'noise', got 'nois'",
        lambda s: sensitivity(s, s.noisy, settings=NOIS),
    ),
    ("one cell", lambda s: sensitivity(s, goal=0)),
    ("block_m", lambda _: ju.studies.ReceiverSettings(block_m=0.0)),
    ("sky_step_s", lambda _: ju.studies.ReceiverSettings(sky_step_s=900.0)),
    (
        "pair 2",
        lambda s: ju.studies.make_queries(
            ju.cost_map(s.crossed, 20.0), [s.ends, [s.ends[0], (0.0, 0.0)]]
        ),
    ),
    ("budget_s", lambda _: FitSettings(budget_s=0)),
    ("no routes", lambda _: fit_weights([])),
    ("hold_out must be a share", lambda s: fitted(s, hold_out=1.0)),
    ("too few to hold some out", lambda s: fitted(s, hold_out=0.9)),
    ("must read like", lambda _: Target.parse("mean_gps")),
    ("finite number", lambda _: Target.parse("detour<=x")),
    ("outcome must be 'mean_NAME of a metric', 'detour'", lambda _: Target.parse("noise>=0.8")),
    ("outcome must be 'mean_gps', 'detour'", lambda _: Target.parse("gps>=0.8")),
    ("must be .* 'mean_lidar', got 'mean_risk'", lambda s: targets(s, "mean_risk>=0.5")),
    (
        "you mean 'mean_noise'",
        lambda s: fit_targets(made_queries(ju.cost_map(s.noisy, 20.0), 1), ["mean_nois<=0.2"]),
    ),
    ("has no altitude", lambda s: shown(s, altitude_m=None)),
    ("from 20 to 60 m", lambda s: shown(s, altitude_m=13.0)),
    ("number of metres", lambda s: shown(s, altitude_m="high")),
    ("day, night", lambda s: shown(s, altitude_m=20.0, time_of_day="noon")),
    ("leaves the maps", lambda s: routes(s, FAR, altitude_m=60.0)),
    (
        "one cell",
        lambda s: routes(
            s, np.add(s.small.grid.xy_of_cell(0, 0), [(0, 0), (2, 0)]), altitude_m=60.0
        ),
    ),
    (
        "metric must be 'gps', .* got 'gsp'",
        lambda s: routes(s, FAR, altitude_m=60.0, metrics=["gsp"]),
    ),
    (r"^(?!.*give).*line 1 \('1', from .*\): it starts or ends inside an obstacle", inside),
    ("no free cell is within 50 m of it", inside),
    ("normalise", lambda _: alike([1e4, 1e4], [2e4, 2e4])),
    ("take one time of day", lambda _: alike([2e4, 3e4], by="time")),
    ("crs = 'EPSG:32618'", lambda s: compare(s, lambda ds: ds.assign_attrs(crs="EPSG:32617"))),
    (
        "share no cell",
        lambda s: compare(s, lambda ds: ds.isel(y=slice(0, 5)).assign_coords(y=ds.y[:5] + 5000.0)),
    ),
    ("share no altitude", lambda s: compare(s, lambda ds: ds.assign_coords(altitude=[30.0, 70.0]))),
    (
        "seed must be a whole number from 0 up",
        lambda s: ju.studies.compare(s.alpha, s.alpha, routes=1, seed=-1),
    ),
    (
        "10 m wide in EPSG:32618 and B's 5 m.*resolution_m",
        lambda s: compare(s, lambda _: made_maps(resolution_m=5).ds),
    ),
]
NOIS = ju.studies.SensitivitySettings(vary=("nois",))


@pytest.mark.parametrize(("sentence", "call"), ROWS, ids=[sentence for sentence, _ in ROWS])
def test_wrong_input_is_refused_in_one_sentence_and_nothing_is_written(
    request, tmp_path, sentence, call
):
    with pytest.raises(ju.InputError, match=sentence) as refused:
        call(Scene(request))
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "out").exists()


def test_one_weight_may_be_named_by_its_name_alone():
    assert ju.studies.SensitivitySettings(vary="gps").vary == ("gps",)
