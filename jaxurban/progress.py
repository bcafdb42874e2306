"""Progress of long jobs: a bar on a terminal, elsewhere lines in the log "jaxurban"; and how long stages take."""

import io
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

LOG = logging.getLogger("jaxurban")
SILENT_S = 5.0  # that a search may last before the log says that it runs
EVERY_S = 10.0  # between two lines of the log on one stage; shorter ones have none
BRIEF_S = 0.5  # a stage that ends sooner shows no bar
# Until then what was compiled for the first items would be forecast for all of them.
EARLY_S, EARLY_SHARE = 60.0, 0.05
WITHOUT_TOTAL = "{desc} [{elapsed}{postfix}]"
WITHOUT_FORECAST = "{desc}: {percentage:3.0f}% {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
WITH_FORECAST = "{desc}: {percentage:3.0f}% {n_fmt}/{total_fmt} [{elapsed}<{remaining}{postfix}]"

# Set by the command line at Ctrl-C, which is lost where a callback of JAX gets it.
interrupted = threading.Event()
# `Stopwatch.stage`, or nullcontext where nothing is timed.
Stage = Callable[[str], AbstractContextManager[object]]
Item = TypeVar("Item")
Progress = bool | Callable[[str, int, int], object]  # a function gets stage, done, total


class Report:
    """What a job reports its progress to: ``report("tiles", 3, 12)``. This one says nothing, or calls a function."""

    def __init__(self, function: Callable[[str, int, int], object] | None = None) -> None:
        self._function = function

    def __call__(self, stage: str, done: int = 0, total: int = 0, **counts: object) -> None:
        """Report how far a job is.

        Args:
          stage: that runs.
          done: how much of it is done.
          total: how much there is to do; 0: not known.
          counts: what else was counted, by name.

        Raises:
          KeyboardInterrupt: Ctrl-C came where it could not be raised.
        """
        if interrupted.is_set():
            raise KeyboardInterrupt
        self.show(stage, done, total, counts)

    def over(self, stage: str, items: Sequence[Item]) -> Iterator[Item]:
        """Yield items, and report how many of them are done: before each, and after the last."""
        for done, item in enumerate(items):
            self(stage, done, len(items))
            yield item
        if items:
            self(stage, len(items), len(items))

    def show(self, stage: str, done: int, total: int, counts: Mapping[str, object]) -> None:
        """Show what the job reported."""
        if self._function:
            self._function(stage, done, total)


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


@contextmanager
def warn_if_slow(planner: str, budget_s: float) -> Iterator[None]:
    """Log a warning that a planner is still running if the block, which is its search, lasts `SILENT_S` or longer.

    Args:
      planner: its name.
      budget_s: seconds that the search may take, compilation excluded; a shorter budget than `SILENT_S` never warns.
    """
    sentence = (
        "%s is still running: its search may take up to %g s (budget_s), compilation excluded"
    )
    timer = threading.Timer(SILENT_S, LOG.warning, (sentence, planner, budget_s))
    timer.daemon = True
    if budget_s > SILENT_S:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def reporting(title: str, progress: Progress = True) -> Iterator[Report]:
    """Yield what a job reports its progress to within the block, at whose end a bar is closed.

    Args:
      title: of the job.
      progress: True for a bar on stderr or, where that is not a terminal, lines in the log (level INFO) on long stages,
        with their total and the time that is left; False for nothing; a function that gets ``stage``, ``done`` and
        ``total`` (0: not known); or the report of a larger job, which is yielded as it is.
    """
    if isinstance(progress, Report):
        yield progress
    elif progress is not True:
        yield Report(progress or None)
    else:
        report = _Bar(title)
        try:
            yield report
        finally:
            report.close()


class _Bar(Report):
    """The bar of the stage that runs; where stderr is not a terminal, its numbers in the log every `EVERY_S`."""

    def __init__(self, title: str) -> None:
        self.title, self.stage = title, ""
        self.is_terminal = sys.stderr.isatty()
        self.bar: Any = None

    def show(self, stage: str, done: int, total: int, counts: Mapping[str, object]) -> None:
        """Draw the bar of a stage, a new one where the stage has changed.

        The time that is left stands in it once enough is done for a forecast, unless the total is not known.

        Args:
          stage, done, total: as in `Report.__call__`.
          counts: what else was counted, by name; it stands at the end of the bar.
        """
        from tqdm import tqdm

        # A new bar where the stage has changed.
        if stage != self.stage:
            self.close()
            self.stage = stage
            look: dict[str, Any] = {"file": sys.stderr, "mininterval": 0.1, "delay": BRIEF_S}
            if not self.is_terminal:
                look = {"file": _Log(), "mininterval": EVERY_S, "delay": EVERY_S}
            name = f"{self.title}: {stage}"
            self.bar = tqdm(desc=name, initial=done, leave=self.is_terminal, **look)

        # Whether the total and a forecast of the time that is left stand in it.
        self.bar.total = total or None
        is_early = done < EARLY_SHARE * total and self.bar.format_dict["elapsed"] < EARLY_S
        if not total:
            self.bar.bar_format = WITHOUT_TOTAL
        elif is_early:
            self.bar.bar_format = WITHOUT_FORECAST
        else:
            self.bar.bar_format = None if self.is_terminal else WITH_FORECAST  # None: tqdm's own

        self.bar.set_postfix(counts, refresh=False)
        self.bar.update(done - self.bar.n)

    def close(self) -> None:
        """End the stage that runs."""
        if self.bar is not None:
            self.bar.update(0)  # shows a long stage without counts
            self.bar.close()


class _Log(io.StringIO):
    """A file whose lines go to the log."""

    def write(self, text: str) -> int:
        line = text.strip()
        if line:
            LOG.info(line)
        return len(text)
