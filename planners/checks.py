"""What planners check before they begin, and what they say of a path that costs nothing."""

from collections.abc import Collection

from jaxurban.errors import InputError, nearest_name


def check_budget(budget_s: float) -> None:
    """Raise InputError unless the budget is a positive number of seconds."""
    if not budget_s > 0:
        raise InputError(f"budget_s must be a positive number of seconds, got {budget_s}")


def check_name(kind: str, name: str, accepted: Collection[str]) -> None:
    """Raise InputError unless the name, of a heuristic or the like, is accepted."""
    if name not in accepted:
        raise InputError(f"unknown {kind} {name!r}{nearest_name(name, accepted)}: choose one of {', '.join(accepted)}")


def free_ride(distance_weight: float, cost: float) -> str:
    """Return what to say of a path that costs nothing, else nothing."""
    if distance_weight == 0 and cost == 0:
        return "The path costs nothing under these weights, so its shape means nothing: weigh the distance too."
    return ""
