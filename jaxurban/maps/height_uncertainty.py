"""Height uncertainty: how much the metric maps spread when building heights are drawn as well as they are known.

Every sample draws one error for each building (never one for each cell: a roof moves as a whole);
`jaxurban.maps.recipe` rasterises the city anew and makes its maps. Errors are normal, independent between buildings,
with a standard deviation by where the height came from; heights never fall below 0.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np

from jaxurban.settings import HeightStd
from jaxurban.world.city import City, HeightOrigin

TAIL = 0.05  # the percentiles reported are the 5th and the 95th


def standard_deviations_m(origin: np.ndarray, height_std_m: HeightStd) -> np.ndarray:
    """Return the standard deviation of buildings by their `HeightOrigin`, 0 for those of the synthetic city."""
    by_origin = asdict(height_std_m) | {"layer": height_std_m.default}
    return np.array([by_origin.get(o.name.lower(), 0.0) for o in HeightOrigin])[origin]


def perturbed_cities(city: City, height_std_m: HeightStd, num_samples: int, seed: int) -> Iterator[City]:
    """Yield the city with heights drawn anew, once a sample; the same seed gives the same cities."""
    if city.roofs is not None:
        from scipy.ndimage import label

        labels, num_buildings = label(np.nan_to_num(city.roofs.values) > 0, structure=np.ones((3, 3)))
    for sample in range(num_samples):
        rng = np.random.default_rng([seed, sample])
        if city.buildings is not None:
            std_m = standard_deviations_m(city.buildings.origin, height_std_m)
            errors_m = rng.standard_normal(len(city.buildings)) * std_m
            height_m = np.maximum(city.buildings.height_m + errors_m, 0.0)
            floor_m = city.buildings.min_height_m
            floor_m = np.where(floor_m > 0, np.maximum(floor_m + errors_m, 0.0), floor_m)  # what hangs moves as a whole
            yield replace(city, buildings=replace(city.buildings, height_m=height_m, min_height_m=floor_m))
        else:
            assert city.roofs is not None
            errors_m = np.append(0.0, rng.standard_normal(num_buildings) * height_std_m.raster)[labels]
            values = np.where(labels > 0, np.maximum(city.roofs.values + errors_m, 0.0), city.roofs.values)
            yield replace(city, roofs=replace(city.roofs, values=values.astype(np.float32)))


class Spread:
    """Mean, standard deviation and the two tail percentiles of arrays that come one by one.

    Mean and deviation after Welford (1962). For the percentiles only the lowest and the highest few arrays are kept:
    of 32 samples three each.
    """

    def __init__(self, num_samples: int):
        self.num_samples, self.count = num_samples, 0
        position = TAIL * (num_samples - 1)
        self.below = math.floor(position)
        self.share = position - self.below
        self.kept = min(self.below + 2, num_samples)

    def add(self, values: np.ndarray) -> None:
        """Take in one more array, of the shape of all others."""
        values = np.asarray(values, np.float32)
        if self.count == 0:
            self.mean, self.squares = np.zeros_like(values), np.zeros_like(values)
            self.lowest = self.highest = np.empty((0, *values.shape), np.float32)
        self.count += 1
        from_old = values - self.mean
        self.mean += from_old / self.count
        self.squares += from_old * (values - self.mean)
        self.lowest = np.sort(np.concatenate([self.lowest, values[None]]), axis=0)[: self.kept]
        self.highest = np.sort(np.concatenate([self.highest, values[None]]), axis=0)[-self.kept :]

    def results(self) -> dict[str, np.ndarray]:
        """Return ``mean``, ``std`` (of the sample, n - 1), ``p05`` and ``p95`` (linear between samples)."""
        last = self.kept - 1
        low, low_next = self.lowest[self.below], self.lowest[min(self.below + 1, last)]
        high, high_next = self.highest[last - self.below], self.highest[max(last - self.below - 1, 0)]
        return {
            "mean": self.mean,
            "std": np.sqrt(self.squares / max(self.count - 1, 1)),
            "p05": low + self.share * (low_next - low),
            "p95": high + self.share * (high_next - high),
        }
