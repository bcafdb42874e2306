"""Height uncertainty: how much the metric maps spread when building heights are drawn as well as they are known.

Every sample draws one error for each building (never one for each cell: a roof moves as a whole);
`jaxurban.maps.recipe` rasterises the city anew and makes its maps. Errors are normal, independent between buildings,
with a standard deviation by where the height came from; heights never fall below 0.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from jaxurban.errors import InputError, typed
from jaxurban.world.city import City, HeightOrigin

MOST_SAMPLES = 1000
TAIL = 0.05  # the percentiles reported are the 5th and the 95th


def check_samples(num_samples: int) -> None:
    """Raise InputError unless so many samples make a spread, or none is asked for."""
    if num_samples != 0 and not 2 <= num_samples <= MOST_SAMPLES:
        raise InputError(
            f"height_samples must be 0, for none, or from 2 to {MOST_SAMPLES:,} (each makes all maps anew, and a tenth "
            f"of them are held in memory), got {num_samples}"
        )


@typed
@dataclass(frozen=True)
class HeightStd:
    """Standard deviation of a building's height by its origin, metres; 0: known exactly.

    The defaults are rules of thumb for low and middle heights; give your source's own where it states them. Among OSM
    buildings that carry both, height minus 3 m x levels varies by 4.5 m (robust; mean +6.6 m) in Lower Manhattan, by
    7.4 m (+3.2 m) up to 8 levels there and by 5.6 m (+4.8 m) in Boston, most of it from towers and from counts that
    leave parts out. Offsets do not belong to this class: change ``level_height_m`` and ``default_height_m`` instead.

    Attributes:
      height: a tag or column: values are rounded to a metre and leave open whether a parapet or a machine room counts.
      levels: number of levels x level height: a storey more or less (ground floors and roofs differ).
      default: nothing known but that a building stands: half the default height of 10 m; more among towers. Also of
        decks whose height is guessed by their layer.
      raster: a height raster, where a component of touching pixels above 0 counts as one building.

    Raises:
      InputError: a value that is negative or not finite.
    """

    height: float = 1.0
    levels: float = 3.0
    default: float = 5.0
    raster: float = 1.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"height_std_m {item.name} must be a number of metres >= 0, got {value}")

    def of(self, origin: np.ndarray) -> np.ndarray:
        """Return the standard deviation of buildings by their `HeightOrigin`, 0 for those of the synthetic city."""
        by_origin = {item.name: getattr(self, item.name) for item in fields(self)} | {"layer": self.default}
        return np.array([by_origin.get(o.name.lower(), 0.0) for o in HeightOrigin])[origin]


def perturbed_cities(city: City, height_std: HeightStd, num_samples: int, seed: int) -> Iterator[City]:
    """Yield the city with heights drawn anew, once a sample; the same seed gives the same cities."""
    if city.roofs is not None:
        from scipy.ndimage import label

        labels, num_buildings = label(np.nan_to_num(city.roofs.values) > 0, structure=np.ones((3, 3)))
    for sample in range(num_samples):
        rng = np.random.default_rng([seed, sample])
        if city.buildings is not None:
            errors_m = rng.standard_normal(len(city.buildings)) * height_std.of(city.buildings.origin)
            height_m = np.maximum(city.buildings.height_m + errors_m, 0.0)
            floor_m = city.buildings.min_height_m
            floor_m = np.where(floor_m > 0, np.maximum(floor_m + errors_m, 0.0), floor_m)  # what hangs moves as a whole
            yield replace(city, buildings=replace(city.buildings, height_m=height_m, min_height_m=floor_m))
        else:
            assert city.roofs is not None
            errors_m = np.append(0.0, rng.standard_normal(num_buildings) * height_std.raster)[labels]
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
