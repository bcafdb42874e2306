"""How long each stage of the work takes, and what is reported while it runs."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field

from jaxurban.progress import Report

Stage = Callable[[str], AbstractContextManager[None]]


def untimed(name: str) -> AbstractContextManager[None]:
    """Return a context that does nothing with the stage it gets."""
    return nullcontext()


@dataclass
class Stopwatch:
    """Seconds by stage; a stage entered again adds to its time. One for each thread.

    Attributes:
      elapsed_s: seconds by stage.
      on_stage: gets each stage that begins.
    """

    elapsed_s: dict[str, float] = field(default_factory=dict)
    on_stage: Report = field(default_factory=Report)

    def add(self, name: str, seconds: float) -> None:
        """Add to the time of a stage."""
        self.elapsed_s[name] = self.elapsed_s.get(name, 0.0) + seconds

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under ``name``."""
        self.on_stage(name)
        began = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - began)
