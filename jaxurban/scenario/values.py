"""Kinds of values in a scenario, each with its check."""

from datetime import datetime
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, GetPydanticSchema, PlainSerializer

from jaxurban.metrics.weights import MOST_WEIGHT, Weights
from jaxurban.planners.registry import find_planner

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
PositiveInt = Annotated[int, Field(gt=0)]


def _no_truth(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError(f"a weight cannot be {str(value).lower()}: give a number")
    return value


def _not_too_heavy(weight: float) -> float:
    if weight > MOST_WEIGHT:
        raise ValueError(f"a weight must be at most {MOST_WEIGHT:g}, got {weight:g}")
    return weight


Weight = Annotated[NonNegative, BeforeValidator(_no_truth), AfterValidator(_not_too_heavy)]
WeightTable = Annotated[  # weights by name; `Scenario` knows which names there are
    dict[str, Weight], AfterValidator(lambda named: Weights(**named)), PlainSerializer(Weights.to_dict)
]
WeightSettings = Annotated[Weights, GetPydanticSchema(lambda _, handler: handler.generate_schema(WeightTable))]


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


def _all_different(values: tuple) -> tuple:
    if len({f"{value:g}" if isinstance(value, float) else value for value in values}) < len(values):
        raise ValueError("names a value twice (file names carry six digits)")
    return values


def _known_planner(name: str) -> str:
    find_planner(name)
    return name


PlannerName = Annotated[str, AfterValidator(_known_planner)]


def _as_utc(time: datetime) -> datetime:
    from jaxurban.io.read.orbits import parse_time  # imported here: it brings Skyfield

    return parse_time(time)


Utc = Annotated[datetime, AfterValidator(_as_utc)]  # a naive time is UTC already
Seed = Annotated[int, Field(ge=0)]
StrList = Annotated[tuple[str, ...], BeforeValidator(_as_list), Field(min_length=1)]
Different = AfterValidator(_all_different)
DifferentList = Annotated[tuple[Positive, ...], BeforeValidator(_as_list), Field(min_length=1), Different]
Profile = tuple[float, ...]
