"""How a command ends: the codes that docs/reference/stability.md promises."""

from enum import IntEnum


class ExitCode(IntEnum):
    """What the shell gets from a command."""

    DONE = 0  # a path, or a finished job
    FAULT = 1  # of jaxurban: Python's own code of an exception
    BAD_INPUT = 2  # or wrong usage
    NO_PATH = 3
    UNKNOWN = (
        4  # the budget is spent, or the method ended: no path, and no proof that there is none
    )
    FINDINGS = 5  # of a check
    NOT_JUDGED = 6  # a check found nothing, and could not judge all
    INTERRUPTED = 130
