"""What planners check before they begin."""

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


def power_of_two(number: int) -> int:
    """Return the least power of two that is not below a number, so that few shapes are compiled."""
    return 1 << (number - 1).bit_length()
