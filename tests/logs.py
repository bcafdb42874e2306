"""What jaxurban tells in its log, for tests."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager


class _Keeper(logging.Handler):
    def __init__(self, level: int) -> None:
        super().__init__(level)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


@contextmanager
def logged(level: int = logging.WARNING) -> Iterator[list[str]]:
    """Yield the messages of the log, as they come."""
    log, keeper = logging.getLogger("jaxurban"), _Keeper(level)
    log.addHandler(keeper)
    try:
        yield keeper.messages
    finally:
        log.removeHandler(keeper)
