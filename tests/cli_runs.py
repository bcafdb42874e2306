"""Running the command line in this process, for tests."""

import math
from unittest.mock import patch

import pytest

from jaxurban import progress
from jaxurban.cli import main as cli


def run(capsys, *arguments: object) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of one command."""
    # An error stands alone only in the first seconds of a job, which may be long on a busy machine.
    with pytest.raises(SystemExit) as ended, patch.object(progress, "EVERY_S", math.inf):
        cli.main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return ended.value.code, out, err


def assert_one_sentence(err: str, *words: str) -> None:
    """Check that stderr is one error line that holds all of ``words``."""
    assert err.startswith("jaxurban: error: "), err
    assert len(err.strip().splitlines()) == 1, err
    for word in words:
        assert word in err
