"""Small maps and queries for tests of studies."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import ndimage

import jaxurban as ju
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.cost_map import CostMap
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.queries import RouteQuery
from tests.made_maps import made_maps

HIDDEN = ju.Weights(distance=0.02, gps=0.35, lidar=0.15, population=0.2, risk=0.28)


def small_maps() -> MetricMaps:
    """Return maps of 36 x 40 cells; metrics vary from cell to cell, so that routes depend on weights finely."""
    maps = made_maps(36, 40)
    rng = np.random.default_rng(1)
    for name in ("gps", "lidar", "population", "risk"):
        rough = ndimage.gaussian_filter(rng.uniform(size=maps.ds[name].shape), [0] * (maps.ds[name].ndim - 2) + [1, 1])
        maps.ds[name][:] = ((rough - rough.min()) / np.ptp(rough)).astype(np.float32)
    return maps


def made_queries(unit: CostMap, num: int, seed: int = 0, apart: float = 18.0) -> list[RouteQuery]:
    """Return queries between random free cells that are connected and at least so many cells apart."""
    labels, _ = ndimage.label(unit.is_free)
    free = np.argwhere(labels == np.bincount(labels[labels > 0]).argmax())
    rng = np.random.default_rng(seed)
    queries: list[RouteQuery] = []
    while len(queries) < num:
        a, b = free[rng.integers(len(free), size=2)].tolist()
        if np.hypot(a[0] - b[0], a[1] - b[1]) >= apart:
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


def write_geojson(file: Path, demonstrations: Sequence[Demonstration], **properties) -> Path:
    """Write demonstrations as lines through the centres of their cells."""
    features = []
    for each in demonstrations:
        grid = each.query.cost_map.grid
        xy_m = each.points_m + np.array([grid.x_min_m, grid.y_min_m])
        lonlat = np.round(np.stack(grid.lonlat_of_xy(xy_m[:, 0], xy_m[:, 1]), axis=-1), 7)
        known = {"altitude_m": each.query.cost_map.altitude_m} | properties
        features.append(
            {
                "type": "Feature",
                "properties": {name: value for name, value in known.items() if value is not None},
                "geometry": {"type": "LineString", "coordinates": lonlat.tolist()},
            }
        )
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return file
