"""Soft GPS maps by a measured chance of reception: the curve, its maps and their slopes, and the log it is from."""

import math
from dataclasses import replace

import geopandas as gpd
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize
from scipy.special import expit

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.rasterise import build_surface
from jaxurban.kernels.dop import dops, unit_vectors
from jaxurban.kernels.shadows.sweep import (
    digital_line,
    digital_lines,
    heights_by_doubling,
    heights_by_sweep,
    shadow_height,
    shadow_heights,
    stacked,
)
from jaxurban.metrics.gps import gps_metric, soft_gps
from jaxurban.world.grid import Grid
from tests.metrics.soft.scene import (
    ALTITUDE_M,
    AZIMUTH_RAD,
    ELEVATION_RAD,
    GRID,
    HILLS_M,
    REGION,
    Case,
    check_gradient,
)
from tests.metrics.whole_maps import gdop_by_inverse

CURVE = ju.grad.ReceptionCurve.measured_in_tokyo()
LEAVES = {name: getattr(CURVE, name) for name in ("intercept", "slope", "scale_m", "cut_m")}
WINDOW = REGION.window_in(GRID)
MIX = np.random.default_rng(1).uniform(0.5, 1.5, REGION.shape)


def heard(surface, at, view, cells=None):
    view = view._replace(lines=view.lines._replace(drop_m=at["drop_m"]))
    curve = ju.grad.ReceptionCurve(*(at[name] for name in LEAVES))
    return soft_gps(
        surface, at["altitude_m"], at["limit"], at["softness_m"], view, cells=cells, reception=curve
    )


LEVEL, HILLY = Case(heard, lambda *_: None, 20.0), Case(heard, lambda *_: None, 20.0, 4 * HILLS_M)


def inputs_of(case, dtype=np.float64, **changes):
    return case.inputs(dtype, **LEAVES | {"drop_m": case.view(dtype).lines.drop_m} | changes)


def clearances(case):
    """Return how high receivers stand over the edges of the roofs' and of the ground's shadows, ``[S, y, x]`` each."""
    roof_m = np.asarray(case.surface(np.float64).roof_m)
    ground_m = np.zeros(GRID.shape) if case.ground_m is None else case.ground_m
    place = GRID.resolution_m, GRID.first_row, GRID.first_col, GRID.shape
    lines = [
        digital_line(*toward, *place) for toward in zip(AZIMUTH_RAD, ELEVATION_RAD, strict=True)
    ]
    tops_m = np.where(roof_m > 0, ground_m + roof_m, -np.inf), ground_m
    edges_m = (
        np.array([shadow_height(jnp.asarray(top_m), line) for line in lines]) for top_m in tops_m
    )
    by_roofs_m, by_ground_m = ((ground_m + ALTITUDE_M - edge_m)[:, *WINDOW] for edge_m in edges_m)
    return by_roofs_m, by_ground_m


def chances(margin_m):
    """Return the curve as its log's study writes it."""
    cut_m = np.clip(margin_m, -60, 60)
    return 1 / (1 + np.exp(0.19 - 0.64 * np.sign(cut_m) * np.log(1 + np.abs(cut_m) / 2)))


@pytest.mark.slow
def test_the_curve_has_the_chances_of_the_study_and_their_slopes_by_the_margin_at_the_edge_too():
    margin_m = np.array(
        [-np.inf, -1e30, -60.0, -40.0, -1.0, -1e-9, 0.0, 1e-9, 1.0, 40.0, 60.0, 1e30, np.inf]
    )
    with jax.enable_x64(True):
        np.testing.assert_allclose(CURVE.chance(margin_m), chances(margin_m), rtol=1e-12)
        slopes = jax.vmap(jax.grad(CURVE.chance))(jnp.asarray(margin_m[3:-3]))
        beyond = jax.vmap(jax.grad(CURVE.chance))(jnp.array([-np.inf, -61.0, 61.0, np.inf]))
    np.testing.assert_array_equal(beyond, 0)
    expected = (chances(margin_m[3:-3] + 1e-6) - chances(margin_m[3:-3] - 1e-6)) / 2e-6
    np.testing.assert_allclose(slopes, expected, rtol=1e-5)
    at_edge = 1 / (1 + math.exp(0.19))
    np.testing.assert_allclose(
        slopes[margin_m[3:-3] == 0], 0.64 / 2 * at_edge * (1 - at_edge), rtol=1e-12
    )


@pytest.mark.slow
def test_slopes_of_the_map_by_heights_altitude_and_coefficients_equal_central_differences():
    with jax.enable_x64(True):
        inputs, view = inputs_of(HILLY), HILLY.view(np.float64)
        check_gradient(
            jax.jit(jax.value_and_grad(lambda inputs: jnp.sum(MIX * HILLY.m(inputs, view)))), inputs
        )


@pytest.mark.slow
@pytest.mark.parametrize("case", [LEVEL, HILLY], ids=["level", "hills"])
def test_the_map_is_the_dop_of_satellites_weighted_by_the_squares_of_their_chances(case):
    with jax.enable_x64(True):
        by_roofs_m, by_ground_m = clearances(case)
        m = np.asarray(case.m(inputs_of(case), case.view(np.float64)))
        single = np.asarray(case.m(inputs_of(case, np.float32), case.view()))
        roof_m = np.asarray(case.surface(np.float64).roof_m)[WINDOW]
    assert np.isinf(by_roofs_m).any()
    weights = chances(by_roofs_m) ** 2
    if case is HILLY:
        assert (by_ground_m < 0).any()
        weights = weights / (1 + np.exp(-by_ground_m / case.softness_m)) ** 2
    gdop = gdop_by_inverse(weights, unit_vectors(AZIMUTH_RAD, ELEVATION_RAD))
    t = np.where(roof_m > 0, np.clip((ALTITUDE_M - roof_m) / case.softness_m, 0, 1), 1)
    expected = (
        t**3
        * (10 - 15 * t + 6 * t**2)
        * (case.limit - np.minimum(gdop, case.limit))
        / (case.limit - 1)
    )
    assert np.mean((expected > 0) & (expected < 0.85)) > 0.1
    np.testing.assert_allclose(m, expected, atol=1e-9)
    np.testing.assert_allclose(single, expected, atol=1e-4)


def test_the_map_is_nearer_to_its_mean_over_satellites_heard_by_chance_than_weights_of_the_chances_make_it():
    chance = chances(clearances(LEVEL)[0]).astype(np.float32)
    draws = np.random.default_rng(0).random((400, *chance.shape)) < chance
    view = LEVEL.view(multiple_of=1)
    m_of = jax.jit(lambda weights: gps_metric(dops(view.satellites, weights).gdop, LEVEL.limit))
    mean = np.mean([m_of(jnp.asarray(each, jnp.float32)) for each in draws], axis=0)
    squared, plain = (np.abs(m_of(jnp.asarray(chance**power)) - mean).mean() for power in (2, 1))
    assert squared < 0.75 * plain


@pytest.mark.slow
def test_at_the_edge_of_a_shadow_the_map_has_a_slope_and_beyond_the_cut_it_is_level_and_finite():
    with jax.enable_x64(True):
        view = LEVEL.view(np.float64)
        by_roofs_m, _ = clearances(LEVEL)
        satellite, row, col = np.argwhere(
            (np.abs(by_roofs_m) < 10) & (np.asarray(LEVEL.surface().roof_m)[WINDOW] == 0)
        )[0]
        at_edge_m = ALTITUDE_M - by_roofs_m[satellite, row, col]

        @jax.jit
        @jax.value_and_grad
        def of(inputs):
            return LEVEL.m(inputs, view, np.array([[row, col]]))[0]

        edge = inputs_of(LEVEL, altitude_m=at_edge_m)
        ends = [of(edge | {"altitude_m": edge["altitude_m"] + step})[0] for step in (1e-6, -1e-6)]
        assert float(of(edge)[1]["altitude_m"]) == pytest.approx(
            float(ends[0] - ends[1]) / 2e-6, rel=1e-5
        )
        m, slopes = of(inputs_of(LEVEL, altitude_m=500.0))
        assert not np.any(slopes["height_m"])
        assert not np.any(slopes["altitude_m"])
        gdop = gdop_by_inverse(np.ones(len(AZIMUTH_RAD)), unit_vectors(AZIMUTH_RAD, ELEVATION_RAD))
        assert float(m) == pytest.approx((20 - gdop / chances(60.0)) / 19)
        _, behind = of(inputs_of(LEVEL, height_m=np.full(30, 1e4), intercept=-9.0))
        assert all(np.all(np.isfinite(values)) for values in behind.values())


@pytest.mark.slow
def test_both_forms_of_the_shadows_know_where_no_roof_is():
    roof_m = jnp.asarray(LEVEL.surface().roof_m)
    top_m, lines, window = (
        jnp.where(roof_m > 0, roof_m, -jnp.inf),
        LEVEL.view().lines,
        (9, 24, 9, 27),
    )
    swept, doubled = (
        form(top_m, lines, window) for form in (heights_by_sweep, heights_by_doubling)
    )
    np.testing.assert_allclose(doubled, swept, atol=1e-3)
    slopes = jax.grad(
        lambda top_m: jnp.sum(CURVE.chance(20.0 - heights_by_doubling(top_m, lines, window)))
    )(top_m)
    assert np.isfinite(slopes).all()
    assert np.any(slopes)


@pytest.mark.parametrize(
    ("name", "value"), [("slope", 0.0), ("scale_m", -2.0), ("cut_m", np.inf), ("intercept", np.nan)]
)
def test_a_coefficient_that_makes_no_curve_is_refused(name, value):
    with pytest.raises(InputError, match=f"{name} must be a"):
        replace(CURVE, **{name: value})


def log_loss(chance, is_strong):
    return -np.log(np.where(is_strong, chance, 1 - chance)).mean()


def fitted(x, is_strong):
    """Return the logistic regression on x, intercept and slope."""
    return minimize(lambda both: log_loss(expit(both[0] + both[1] * x), is_strong), [0.0, 1.0]).x


def margins(log, city, region):
    """Return the margins to the shadow of roofs 2 m over the ground, with a direction per satellite and 30 s."""
    surface = build_surface(city, region, region.padded(150, 150, 150, 150))
    row, col = region.cell_of_lonlat(log.lon_deg.to_numpy(), log.lat_deg.to_numpy())
    part = (log.utc - log.utc.min()).dt.total_seconds() // 30
    toward = np.radians(log[["azimuth_deg", "elevation_deg"]]).groupby([log.satellite, part])
    assert (
        np.degrees(toward.azimuth_deg.agg(np.ptp).max()) < 2
    )  # none passes north, where a mean would be wrong
    azimuth_rad, elevation_rad = toward.mean().to_numpy().T
    azimuth_rad = azimuth_rad - region.convergence_rad(*region.centre_lonlat)
    place = surface.grid.first_row, surface.grid.first_col, surface.grid.shape
    lines = digital_lines(azimuth_rad, elevation_rad, region.resolution_m, *place)
    top_m = jnp.where(jnp.asarray(surface.roof_m) > 0, surface.roof_m, -jnp.inf)
    rows, cols = surface.window
    cast = jax.jit(
        lambda lines: shadow_heights(top_m, lines, (rows.start, rows.stop, cols.start, cols.stop))
    )
    edge_m = np.empty(len(log))
    for number, line in enumerate(lines):
        here = toward.ngroup().to_numpy() == number
        edge_m[here] = cast(stacked([line]))[0, row[here], col[here]]
    return 2.0 - edge_m


@pytest.mark.slow
@pytest.mark.data
def test_on_its_log_the_curve_is_the_fitted_one_and_loses_less_than_seen_or_hidden_fitted_to_other_blocks(
    data_dir,
):
    """Satellites of four systems, without the unhealthy E18, at 10 degrees and more; strong ones have 35 dBHz."""
    log = pd.read_csv(
        data_dir / "tokyo" / "tokyo_nihonbashi_2023-06-22_satellites.csv.gz", parse_dates=["utc"]
    )
    is_taken = (
        (log.elevation_deg >= 10) & log.satellite.str[0].isin([*"GEJC"]) & (log.satellite != "E18")
    )
    log = log[is_taken].reset_index(drop=True)
    assert len(log) == 8283
    places = log[["lon_deg", "lat_deg"]]
    bounds = *places.min() - 4e-4, *places.max() + 4e-4
    city = City.from_files(data_dir / "tokyo" / "tokyo-east-lod2.parquet", bounds=bounds)
    margin_m, is_strong = (
        margins(log, city, Grid.from_bounds(bounds, 2.0, city.crs)),
        log.cn0_dbhz.to_numpy() >= 35,
    )
    track = gpd.GeoSeries.from_xy(log.lon_deg, log.lat_deg, crs=4326).to_crs(city.crs)
    block = (
        np.hypot(track.x.diff(), track.y.diff()).fillna(0).cumsum() // 50
    ).to_numpy()  # rows are in order of time
    assert len(np.unique(block)) == 33
    is_seen, x = margin_m >= 0, np.sign(margin_m) * np.log1p(np.minimum(np.abs(margin_m), 60) / 2)
    seen_or_hidden, refitted = np.empty((2, len(log)))
    for here in (block == number for number in np.unique(block)):
        for side in (is_seen, ~is_seen):
            seen_or_hidden[here & side] = is_strong[~here & side].mean()
        intercept, slope = fitted(x[~here], is_strong[~here])
        refitted[here] = expit(intercept + slope * x[here])
    loss, refitted_loss = (log_loss(chance, is_strong) for chance in (chances(margin_m), refitted))
    np.testing.assert_allclose(CURVE.chance(margin_m), chances(margin_m), rtol=1e-5)
    assert loss < refitted_loss < log_loss(seen_or_hidden, is_strong) - 0.015
    np.testing.assert_allclose(fitted(x, is_strong), [CURVE.intercept, CURVE.slope], atol=0.1)
