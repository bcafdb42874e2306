"""Uncertain heights: cities whose heights are drawn again, and the spread of what is made of them.

Every sample draws one error for each building (never one for each cell: a roof moves as a whole). Errors are normal,
independent between buildings, with a standard deviation by where the height came from; heights never fall below 0.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np

from jaxurban.io.city import City
from jaxurban.settings import HeightStd
from jaxurban.world.footprints import Footprints, HeightOrigin

TAIL = 0.05  # the percentiles reported are the 5th and the 95th


def perturbed_cities(
    city: City, height_std_m: HeightStd, num_samples: int, seed: int = 0
) -> Iterator[City]:
    """Yield the city with heights drawn again for each sample; the same seed gives the same cities.

    Structures keep their heights. In a city whose roofs are a raster, each connected set of cells with a roof counts as
    one building.

    Args:
      city: with outlines or with a raster of roofs.
      height_std_m: standard deviations of heights, by their origin.
      num_samples: how many cities.
      seed: of the random numbers.
    """
    generators = (np.random.default_rng([seed, sample]) for sample in range(num_samples))

    if city.buildings is not None:
        std_m = _std_of_buildings(city.buildings, height_std_m)
        for rng in generators:
            errors_m = rng.standard_normal(len(std_m)) * std_m
            yield replace(city, buildings=_moved(city.buildings, errors_m))
        return

    assert city.roofs is not None
    from scipy.ndimage import label

    roof_m = city.roofs.values
    labels, num_buildings = label(np.nan_to_num(roof_m) > 0, structure=np.ones((3, 3)))
    for rng in generators:
        # Label 0 is no building, and has no error.
        errors_m = np.append(0.0, rng.standard_normal(num_buildings) * height_std_m.raster)
        moved_m = np.where(labels > 0, np.maximum(roof_m + errors_m[labels], 0.0), roof_m)
        yield replace(city, roofs=replace(city.roofs, values=moved_m.astype(np.float32)))


def _std_of_buildings(buildings: Footprints, height_std_m: HeightStd) -> np.ndarray:
    """Return the standard deviation of the height of each building, ``[B]`` metres, by its origin."""
    by_origin = {**asdict(height_std_m), "generated": 0.0, "unknown": 0.0}
    others_m = height_std_m.default
    std_m = np.array([by_origin.get(origin.name.lower(), others_m) for origin in HeightOrigin])
    return std_m[buildings.origin]


def _moved(buildings: Footprints, errors_m: np.ndarray) -> Footprints:
    """Return buildings whose heights are changed by errors, ``[B]`` metres; what hangs moves with its floor."""
    floor_m = buildings.min_height_m
    return replace(
        buildings,
        height_m=np.maximum(buildings.height_m + errors_m, 0.0),
        min_height_m=np.where(floor_m > 0, np.maximum(floor_m + errors_m, 0.0), floor_m),
    )


class Spread:
    """Mean, standard deviation and the two tail percentiles of arrays that come one by one.

    Mean and deviation after Welford (1962). For the percentiles only the lowest and the highest few arrays are kept:
    of 32 samples three each.
    """

    def __init__(self, num_samples: int):
        """Begin without a sample; ``num_samples`` is how many will be added."""
        self.count = 0
        position = TAIL * (num_samples - 1)
        self.below = math.floor(position)
        self.share = position - self.below
        self.kept = min(self.below + 2, num_samples)

    def add(self, values: np.ndarray) -> None:
        """Take in one more array; all must have the same shape."""
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
        """Return ``mean``, ``std`` (of the sample, n - 1), ``p05`` and ``p95`` (linear between samples), by name.

        All samples must have been added, two of them at least for a deviation other than 0.
        """
        # Each percentile lies between a kept array and the next one inward, which is nearer to the median.
        last = self.kept - 1
        low = self.lowest[self.below]
        low_next = self.lowest[min(self.below + 1, last)]
        above = last - self.below
        high = self.highest[above]
        high_next = self.highest[max(above - 1, 0)]
        return {
            "mean": self.mean,
            "std": np.sqrt(self.squares / max(self.count - 1, 1)),
            "p05": low + self.share * (low_next - low),
            "p95": high + self.share * (high_next - high),
        }
