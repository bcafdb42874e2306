"""Weights and cost maps: what a path pays for the metrics of the cells it crosses."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxurban.checks import MOST, finite, nearest_name, typed
from jaxurban.errors import InputError
from jaxurban.metrics.base import AnyArray as AnyArray
from jaxurban.metrics.registry import METRICS, known_metrics

DISTANCE_WEIGHT, METRIC_WEIGHT = 0.1, 1.0  # of the weights that nobody names
# As of any number: no path's cost overflows up to here, not even in float32.
MOST_WEIGHT = float(MOST)


@jax.tree_util.register_pytree_with_keys_class
@typed
@dataclass(frozen=True, init=False, repr=False)
class Weights:
    """The paper's W: cost per metre, and cost per step (or per reference length) of each metric's cost.

    ``weights["noise"]`` gives any weight by its metric's name, ``weights.gps`` one that is there; a metric that is not
    named weighs 1. A pytree, whose leaves are the weights that are named.

    Attributes:
      values: name and weight, the distance first (w_0, cost per metre of path), then the metrics of every cost (of each
        one's cost c in [0, 1]), then others by name.

    Examples:
      >>> weights = ju.Weights(risk=5.0)
      >>> weights
      Weights(distance=0.1, gps=1.0, lidar=1.0, population=1.0, risk=5.0)
      >>> weights.risk, weights["noise"]
      (5.0, 1.0)
    """

    values: tuple[tuple[str, float | jax.Array], ...]

    def __init__(
        self, distance: float | jax.Array = DISTANCE_WEIGHT, **weights: float | jax.Array
    ) -> None:
        """Hold the weights given and the defaults of the metrics of every cost, in the order of `values`."""
        named = {"distance": distance, **dict.fromkeys(METRICS, METRIC_WEIGHT)}
        named |= sorted(weights.items())
        object.__setattr__(self, "values", tuple(named.items()))

    def __getattr__(self, name: str) -> Any:
        """Return the weight of a name, as in ``weights.gps``."""
        values = dict(self.__dict__.get("values", ()))
        if name not in values:
            raise AttributeError(f"there is no weight {name!r}")
        return values[name]

    def __getitem__(self, name: str) -> float | jax.Array:
        return self.to_dict().get(name, METRIC_WEIGHT)

    def __repr__(self) -> str:
        return f"Weights({', '.join(f'{name}={value!r}' for name, value in self.values)})"

    @classmethod
    def of(cls, given: "WeightsLike", base: Mapping[str, float] | None = None) -> "Weights":
        """Return weights that are given in any of several ways.

        Args:
          given: `Weights`, numbers by name, or None for no names.
          base: weights of the names that ``given`` leaves out; names in neither have the default weights.

        Returns:
          The weights; `Weights` unchanged.

        Raises:
          InputError: ``given`` is none of these.

        Examples:
          >>> ju.Weights.of({"risk": 5.0}, base={"gps": 2.0})
          Weights(distance=0.1, gps=2.0, lidar=1.0, population=1.0, risk=5.0)
        """
        if isinstance(given, Weights):
            return given
        named: Any = {} if given is None else given
        # "self" would be an argument of the class twice.
        if not isinstance(named, Mapping) or not all(
            isinstance(name, str) and name != "self" for name in named
        ):
            raise InputError(
                f'weights must be Weights or numbers by name such as {{"risk": 5}}, got {given!r}'
            )
        return cls(**{**(base or {}), **named})

    @classmethod
    @typed
    def parse(cls, text: str, base: "Weights | None" = None) -> "Weights":
        """Return the weights in a text such as ``"gps=1,noise=2"``.

        Args:
          text: name and number of each weight.
          base: weights of the names that the text leaves out; without it, the defaults.

        Returns:
          The weights, all of them named.

        Raises:
          InputError: a value that is not a number >= 0; `checked` looks at the names too.

        Examples:
          >>> ju.Weights.parse("gps=2,noise=3")
          Weights(distance=0.1, gps=2.0, lidar=1.0, population=1.0, risk=1.0, noise=3.0)
        """
        return cls.of(cls.named_in(text), (base or cls()).to_dict()).checked()

    @staticmethod
    def named_in(text: str) -> dict[str, float]:
        """Return only the weights that a text such as ``"gps=1,noise=2"`` names.

        Returns:
          Number by name, in the order of the text; empty for an empty text.

        Raises:
          InputError: a value that is no number, or a name that comes twice.

        Examples:
          >>> ju.Weights.named_in("gps=1, noise=2")
          {'gps': 1.0, 'noise': 2.0}
        """
        values: dict[str, float] = {}
        for part in filter(None, map(str.strip, text.split(","))):
            name, _, number = map(str.strip, part.partition("="))
            if name in values:
                raise InputError(f"weight {name} is given twice in {text!r}: leave one of them out")
            try:
                values[name] = float(number)
            except ValueError as error:
                raise InputError(
                    f"weight {part!r} must read name=number, as in gps=1,risk=0.5"
                ) from error
        return values

    def to_dict(self) -> dict[str, Any]:
        """Return the weights by name, the distance first.

        Returns:
          Weight by name.

        Examples:
          >>> ju.Weights(risk=5.0).to_dict()
          {'distance': 0.1, 'gps': 1.0, 'lidar': 1.0, 'population': 1.0, 'risk': 5.0}
        """
        return dict(self.values)

    def replace(self, **changes: float | jax.Array) -> "Weights":
        """Return the weights with some of them changed.

        Returns:
          New weights; these stay as they are.

        Examples:
          >>> ju.Weights(risk=5.0).replace(distance=1.0)
          Weights(distance=1.0, gps=1.0, lidar=1.0, population=1.0, risk=5.0)
        """
        return Weights(**self.to_dict() | changes)

    def vector(self, names: Iterable[str]) -> np.ndarray:
        """Return the weights of some names as float64, ``[K]``.

        Returns:
          The weights in the order of the names; 1 for a metric that has none.

        Examples:
          >>> ju.Weights(risk=5.0).vector(["distance", *maps.metrics]).tolist()
          [0.1, 1.0, 1.0, 1.0, 5.0]
        """
        return np.array([float(self[name]) for name in names])

    def checked(self, names: Iterable[str] | None = None) -> "Weights":
        """Return the same weights as floats, once they are checked.

        Args:
          names: of further metrics that may be weighed, beside the built-in ones; left out, any.

        Returns:
          The weights, each a finite number of at least 0.

        Raises:
          InputError: a weight that is negative, above `MOST_WEIGHT` or not finite, or of an unknown name (names the
            nearest one).

        Examples:
          >>> try:
          ...     ju.Weights(risks=5.0).checked(maps.metrics)
          ... except ju.InputError as error:
          ...     print(error)
          unknown weight 'risks' (did you mean 'risk'?)
        """
        if names is not None:
            costs = [name for name, metric in known_metrics().items() if metric.is_cost]
            known = dict.fromkeys(("distance", *costs, *names))
            for name in self.to_dict():
                if name not in known:
                    hint = nearest_name(name, known) or f": the weights are {', '.join(known)}"
                    raise InputError(f"unknown weight {name!r}{hint}")
        values = {name: _number(name, value) for name, value in self.to_dict().items()}
        return Weights(**values)

    def tree_flatten_with_keys(self) -> tuple[tuple, tuple[str, ...]]:
        """Return the weights with their keys, for JAX."""
        names, values = zip(*self.values, strict=True)
        return tuple(zip(map(jax.tree_util.GetAttrKey, names), values, strict=True)), names

    @classmethod
    def tree_unflatten(cls, names: tuple[str, ...], values: Iterable[Any]) -> "Weights":
        """Return weights from their names and from what JAX puts in place of their values, which is not checked."""
        weights = object.__new__(cls)
        object.__setattr__(weights, "values", tuple(zip(names, values, strict=True)))
        return weights


WeightsLike = Weights | Mapping[str, float] | None


def weights_on(maps: Any, given: WeightsLike) -> Weights:
    """Return ``given`` as `Weights`; what a mapping leaves out is as the maps' scenario has it, or by default.

    Args:
      maps: with the ``recorded`` settings and the ``metrics`` of `MetricMaps`.
      given: in any of several ways.

    Raises:
      InputError: an invalid weight, or one above 0 that is given of a metric that the maps do not hold.
    """
    usual = maps.recorded.get("weights")
    weights = Weights.of(given, usual).checked(maps.metrics)
    check_held(given, maps.metrics, usual)
    return weights


def check_held(
    given: WeightsLike, metrics: Iterable[str], usual: Mapping[str, float] | None = None
) -> None:
    """Check that maps hold every layer that a caller gives a weight above 0.

    Of numbers by name all count. `Weights` hold a number for each built-in metric, so that of them the default and the
    usual ones do not count.

    Args:
      given: valid weights.
      metrics: that the maps hold.
      usual: the weights of the maps' scenario; None without one.

    Raises:
      InputError: a weight of a layer that is not there.
    """
    numbers: Any = given or {}
    if isinstance(given, Weights):
        own = usual or {}
        values = given.to_dict().items()
        numbers = {name: x for name, x in values if x not in (METRIC_WEIGHT, own.get(name))}
    held = ("distance", *metrics)
    lost = [name for name, value in numbers.items() if value > 0 and name not in held]
    if lost:
        raise InputError(
            f"weights name {' and '.join(lost)}, of which these maps hold no layer (they hold {', '.join(metrics)}): "
            "leave that weight out, or make maps with the layer"
        )


def _number(name: str, value: Any) -> float:
    """Return a weight as a float.

    Raises:
      InputError: it is not a number, negative, above `MOST_WEIGHT` or not finite.
    """
    number = finite(f"weight {name}", value, "")
    if not 0 <= number <= MOST_WEIGHT:
        raise InputError(
            f"weight {name} must be a finite number >= 0, at most {MOST_WEIGHT:.0e}, got {value}"
        )
    return number
