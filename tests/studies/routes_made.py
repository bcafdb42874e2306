"""Small maps and queries for tests of studies."""

import json
from collections.abc import Sequence
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import shapely
from scipy import ndimage

import jaxurban as ju
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.custom import Layer
from jaxurban.paths.cost_map import CostMap
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.queries import RouteQuery
from tests.made_maps import made_maps

NUM = 16  # demonstrations of every fit: other shapes are compiled anew
NUM_ROUTES = 9  # of the study of weights, a city
STUDY = ju.studies.Study(budget_iterations=200, seed=2)
WEIGHT_STUDY = ju.studies.SensitivitySettings(seed=3)
HIDDEN = ju.Weights(distance=0.02, gps=0.35, lidar=0.15, population=0.2, risk=0.28)


def small_maps() -> MetricMaps:
    """Return maps of 36 x 40 cells; metrics vary from cell to cell, so that routes depend on weights finely."""
    maps = made_maps(36, 40)
    rng = np.random.default_rng(1)
    for name in ("gps", "lidar", "population", "risk"):
        rough = ndimage.gaussian_filter(
            rng.uniform(size=maps.ds[name].shape), [0] * (maps.ds[name].ndim - 2) + [1, 1]
        )
        maps.ds[name][:] = ((rough - rough.min()) / np.ptp(rough)).astype(np.float32)
    return maps


def made_queries(unit: CostMap, num: int, seed: int = 0) -> list[RouteQuery]:
    """Return queries between random free cells that are connected and at least 18 cells apart."""
    labels, _ = ndimage.label(unit.is_free)
    free = np.argwhere(labels == np.bincount(labels[labels > 0]).argmax())
    rng = np.random.default_rng(seed)
    queries: list[RouteQuery] = []
    while len(queries) < num:
        a, b = free[rng.integers(len(free), size=2)].tolist()
        if np.hypot(a[0] - b[0], a[1] - b[1]) >= 18.0:
            queries.append(RouteQuery(unit, (a[0], a[1]), (b[0], b[1])))
    return queries


def thinned(points_m: np.ndarray) -> np.ndarray:
    """Return every sixth point of a route, and its last."""
    return points_m[np.unique(np.append(np.arange(0, len(points_m), 6), len(points_m) - 1))]


def cosine(fit, demonstrations: Sequence[Demonstration], hidden: ju.Weights) -> float:
    """Return the cosine between w_j x std(phi_j) of a fit and of hidden weights."""
    vector = np.array([float(getattr(hidden, name)) for name in fit.names])
    spread = vector * np.std([each.features for each in demonstrations], axis=0)
    return float(fit.table["spread"].to_numpy() @ spread / np.linalg.norm(spread))


def write_lines(file: Path, maps: MetricMaps, *lines_m: np.ndarray, **properties) -> Path:
    """Write lines ``[N, 2]`` of eastings and northings with one set of properties; return the file."""
    lonlat = [
        np.round(np.stack(maps.grid.lonlat_of_xy(*np.transpose(each)), axis=-1), 7)
        for each in lines_m
    ]
    lines = geopandas.GeoDataFrame(
        [properties] * len(lonlat), geometry=[*map(shapely.LineString, lonlat)]
    )
    file.write_text(lines.to_json(drop_id=True))
    return file


def write_geojson(file: Path, demonstrations: Sequence[Demonstration], **properties) -> Path:
    """Write demonstrations as lines through the centres of their cells; a property of None is left out."""
    on = demonstrations[0].query.cost_map
    known = {"altitude_m": on.altitude_m} | properties
    lines_m = [
        each.points_m + np.array([on.grid.x_min_m, on.grid.y_min_m]) for each in demonstrations
    ]
    return write_lines(
        file, on.maps, *lines_m, **{name: each for name, each in known.items() if each is not None}
    )


def with_noise(maps: MetricMaps, loud: np.ndarray) -> MetricMaps:
    """Return maps with a cost layer of their own, called noise, of values from 0 to 1."""
    layer = {"layer": json.dumps(Layer("noise.tif", "high-is-bad", (0.0, 1.0)).record)}
    return MetricMaps(maps.ds.assign(noise=(("y", "x"), loud.astype(np.float32), layer)))


def walled(maps: MetricMaps, *where) -> MetricMaps:
    """Return maps with an obstacle at every altitude everywhere, or at some rows, or some cells of them."""
    obstacle = maps.ds["obstacle"].copy(deep=True)
    obstacle[:, *where] = 1
    return MetricMaps(maps.ds.assign(obstacle=obstacle))


def run_study(name: str, folders: Sequence[Path], out: Path, num: object = None, **how):
    """Run the study of planners on the first of two folders, or that of weights on both; without a number, as usual."""
    if name == "study":
        return ju.studies.study(
            folders[0], out, 12 if num is None else num, **{"settings": STUDY} | how
        )
    num = NUM_ROUTES if num is None else num
    return ju.studies.sensitivity(folders, out, num, **{"settings": WEIGHT_STUDY} | how)


def same_rows(one: pd.DataFrame, other: pd.DataFrame) -> None:
    """Check that rows are equal but for their times."""
    one, other = (
        rows.drop(columns=["elapsed_s", "setup_s"], errors="ignore") for rows in (one, other)
    )
    pd.testing.assert_frame_equal(one, other, check_like=True)
