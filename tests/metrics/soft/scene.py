"""A small city of boxes, every soft metric on it as a function of its inputs, and finite differences of those."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.metrics.gps import Gps, soft_gps
from jaxurban.metrics.lidar import Lidar, compute_lidar, soft_lidar
from jaxurban.metrics.risk import Risk, compute_risk, soft_risk
from jaxurban.metrics.visibility import SkyView
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface, roofs_of
from tests.metrics.whole_maps import compute_gps

HALO = 9  # cells of 5 m: a range or a threshold of 40 m, and one cell more
REGION = Grid("EPSG:32618", 5.0, 901_000, 116_000, 15, 18)
GRID = REGION.padded(HALO, HALO, HALO, HALO)
ALTITUDE_M = 20.3
CELLS = np.array([[0, 0], [3, 11], [14, 17], [7, 7], [9, 2]], np.int32)
# Swept along rows and columns both ways, low and high.
AZIMUTH_RAD = np.radians([10.0, 80.0, 190.0, 285.0, 140.0, 330.0, 235.0, 50.0, 100.0])
ELEVATION_RAD = np.radians([35.0, 50.0, 25.0, 40.0, 65.0, 20.0, 45.0, 15.0, 30.0])


def scene(num_buildings: int = 30, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return ascending heights ``[B]`` and the building under each cell; boxes of 2 to 4 cells, the highest on top."""
    rng = np.random.default_rng(seed)
    building = np.full(GRID.shape, -1, np.int32)
    for number in range(num_buildings):
        row, col = rng.integers(0, GRID.num_rows - 3), rng.integers(0, GRID.num_cols - 3)
        building[row : row + rng.integers(2, 5), col : col + rng.integers(2, 5)] = number
    return np.sort(rng.uniform(4.0, 40.0, num_buildings)), building


HEIGHT_M, BUILDING = scene()
ROW, COL = np.indices(GRID.shape)
HILLS_M = 12 * (1 + np.sin(ROW / 4.1) * np.cos(COL / 5.3))


def surface_of(height_m, building: np.ndarray, terrain_m=None) -> Surface:
    """Return the scene's surface in the type of its heights."""
    height_m = jnp.asarray(height_m)
    terrain = None if terrain_m is None else jnp.asarray(terrain_m, height_m.dtype)
    return Surface(roofs_of(height_m, jnp.asarray(building)), terrain, None, None, GRID, REGION)


def gps(surface, at, view, cells=None):
    view = view._replace(lines=view.lines._replace(drop_m=at["drop_m"])) if "drop_m" in at else view
    return soft_gps(surface, at["altitude_m"], at["limit"], at["softness_m"], view, cells=cells)


@dataclass(frozen=True)
class Case:
    """A soft metric: ``limit`` is the threshold of GDOP, the range or the threshold in metres.

    Attributes:
      soft: of a surface, inputs, a view and cells.
      exact: map of a surface at an altitude.
    """

    soft: Callable
    exact: Callable
    limit: float
    ground_m: np.ndarray | None = None
    softness_m: float = 2.0

    def m(self, inputs, view=None, cells=None):
        """Return the soft metric of a dictionary of inputs; ``roof_m`` is added to the cells with a building."""
        surface = surface_of(inputs["height_m"], BUILDING, inputs.get("terrain_m"))
        if "roof_m" in inputs:
            surface = replace(
                surface, roof_m=surface.roof_m.at[BUILDING >= 0].add(inputs["roof_m"])
            )
        return self.soft(surface, inputs, view, cells)

    def inputs(self, dtype=np.float64, **changes) -> dict[str, jax.Array]:
        """Return the inputs, in float64 under ``jax.enable_x64(True)``."""
        numbers = {"altitude_m": ALTITUDE_M, "limit": self.limit, "softness_m": self.softness_m}
        fields = {
            "height_m": HEIGHT_M,
            "roof_m": np.zeros((BUILDING >= 0).sum()),
            "terrain_m": self.ground_m,
        }
        if self.soft is gps:
            numbers["drop_m"] = self.view(dtype).lines.drop_m
        held = {
            name: value for name, value in (numbers | fields | changes).items() if value is not None
        }
        return {name: jnp.asarray(value, dtype) for name, value in held.items()}

    def surface(self, dtype=np.float32) -> Surface:
        return surface_of(HEIGHT_M.astype(dtype), BUILDING, self.ground_m)

    def view(
        self,
        dtype=np.float32,
        turned_rad: float = 0.0,
        num: int = len(AZIMUTH_RAD),
        multiple_of: int = 32,
    ):
        return SkyView.of(
            self.surface(dtype), AZIMUTH_RAD[:num] + turned_rad, ELEVATION_RAD[:num], multiple_of
        )


def _lidar(surface, at, view, cells=None):
    params = replace(LIDAR, range_m=at["limit"])
    return soft_lidar(
        surface, at["altitude_m"], params, at["softness_m"], cells=cells, reach_m=45.0
    )


def _risk(distance: str) -> tuple[Callable, Callable]:
    def soft(surface, at, view, cells=None):
        params = Risk(at["limit"], distance)
        return soft_risk(
            surface, at["altitude_m"], params, at["softness_m"], cells=cells, reach_m=40.0
        )

    return soft, lambda surface, z_m: compute_risk(surface, [z_m], Risk(39.0, distance))[0]


LIDAR = Lidar(azimuths=24, range_m=39.0, beams=5, field_of_view_deg=(-15.0, 10.0))
SCANNED = _lidar, lambda surface, z_m: compute_lidar(surface, [z_m], LIDAR)[0]
SEEN = (
    gps,
    lambda surface, z_m: compute_gps(surface, AZIMUTH_RAD, ELEVATION_RAD, [z_m], Gps(20.0)).m[0],
)
CASES = {
    "gps": Case(*SEEN, 20.0, HILLS_M),
    "lidar": Case(*SCANNED, 39.0),
    "lidar over hills": Case(*SCANNED, 39.0, HILLS_M),
    "risk": Case(*_risk("slice"), 39.0, softness_m=12.0),
    "solid risk": Case(*_risk("solid"), 39.0),
    "solid risk over hills": Case(*_risk("solid"), 39.0, HILLS_M),
}


def check_gradient(
    value_and_gradient: Callable,
    inputs: dict[str, jax.Array],
    zero: Collection[str] = (),
    rtol: float = 1e-4,
) -> None:
    """Assert that the gradient in every input agrees with central differences, along its strongest axes and at random.

    Each of them must be well away from zero, or agreement would mean nothing.

    Args:
      value_and_gradient: of a dictionary of inputs.
      inputs: where.
      zero: the inputs on which nothing depends.
      rtol: of the derivatives.
    """
    inputs = {
        name: jnp.asarray(values, jnp.float64) for name, values in inputs.items()
    }  # one program: no weak types
    _, gradient = value_and_gradient(inputs)
    assert {*gradient} == {*inputs}
    for name, slope in gradient.items():
        assert bool(jnp.any(slope != 0)) == (name not in zero), name
        strongest = np.argsort(-np.abs(np.ravel(slope)))[: min(3, np.count_nonzero(slope))]
        axes = np.eye(slope.size)[strongest].reshape(-1, *slope.shape)
        anyhow = [np.random.default_rng(2).normal(size=slope.shape)] if slope.ndim else []
        for direction in () if name in zero else (*axes, *anyhow):
            moved = ({name: inputs[name] + step * direction} for step in (1e-6, -1e-6))
            above, below = (float(value_and_gradient(inputs | change)[0]) for change in moved)
            expected = (above - below) / 2e-6
            assert abs(expected) > 1e-6, name
            np.testing.assert_allclose(
                float((slope * direction).sum()), expected, rtol=rtol, err_msg=name
            )
