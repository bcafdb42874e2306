"""Progress of long jobs: a bar on a terminal, elsewhere lines in the log "jaxurban"; and how long stages take."""

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field

LOG = logging.getLogger("jaxurban")
SILENT_S = 5.0  # that a search may last before the log says that it runs
EVERY_S = 10.0  # between two lines on one stage; shorter ones have none

interrupted = threading.Event()  # set by the command line at Ctrl-C, which is lost where a callback of JAX gets it
Stage = Callable[[str], AbstractContextManager[object]]  # `Stopwatch.stage`, or nullcontext where nothing is timed
Progress = bool | Callable[[str, int, int], object]  # a function gets stage, done, total


class Report:
    """What a job tells its progress to: ``report("tiles", 3, 12)``. This one says nothing, or calls a function."""

    def __init__(self, function: Callable[[str, int, int], object] | None = None) -> None:
        self._function = function

    def __call__(self, stage: str, done: int = 0, total: int = 0, **counts: object) -> None:
        """Tell the stage, how much of it is done and of how much (0: not known), and what else was counted.

        Raises:
          KeyboardInterrupt: Ctrl-C came where it could not be raised.
        """
        if interrupted.is_set():
            raise KeyboardInterrupt
        self.show(stage, done, total, counts)

    def show(self, stage: str, done: int, total: int, counts: Mapping[str, object]) -> None:
        """Show what the job reported."""
        if self._function:
            self._function(stage, done, total)

    def finish(self) -> None:
        """End a job that went well."""


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
def saying_later(planner: str, budget_s: float) -> Iterator[None]:
    """Warn that a planner is at work, and for how long, where the block, its search, lasts `SILENT_S` or longer."""
    sentence = "%s is at work: its search may take up to %g s (budget_s), compiling apart"
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
    """Yield what a job tells its progress to.

    Args:
      title: of the job.
      progress: True for a bar on stderr or, where that is not a terminal, lines in the log (level INFO) on long stages,
        with their total and the time that is left; False for nothing; or a function that gets ``stage``, ``done`` and
        ``total`` (0: not known).
    """
    if isinstance(progress, Report):  # of the job that this one is a part of
        yield progress
    elif progress is not True:
        yield Report(progress or None)
    else:
        report = _Bar(title) if sys.stderr.isatty() else _Lines(title)
        try:
            yield report
            report.finish()
        finally:
            if isinstance(report, _Bar):
                report.bar.close()


class _Bar(Report):
    """The bar of the stage that runs."""

    def __init__(self, title: str) -> None:
        from tqdm import tqdm

        self.title, self.stage = title, ""
        self.bar = tqdm(desc=title, file=sys.stderr)

    def show(self, stage: str, done: int, total: int, counts: Mapping[str, object]) -> None:
        if stage != self.stage:
            self.stage = stage
            self.bar.reset()
            self.bar.initial = self.bar.n = done
            self.bar.set_description(f"{self.title}: {stage}", refresh=False)
        self.bar.total = total or None
        self.bar.set_postfix(counts, refresh=False)
        self.bar.update(done - self.bar.n)


class _Lines(Report):
    """Lines in the log on stages that last `EVERY_S` or longer: on the way now and then, and at their end."""

    def __init__(self, title: str) -> None:
        self.title, self.stage, self.how_far, self.first_done = title, "", "", 0
        self.stage_s = self.told_s = time.perf_counter()

    def show(self, stage: str, done: int, total: int, counts: Mapping[str, object]) -> None:
        now_s = time.perf_counter()
        if stage != self.stage:
            self._end_stage(now_s)
            self.stage, self.stage_s, self.told_s, self.first_done = stage, now_s, now_s, done
        parts = [f"{done} of {total}" if total else f"{done}"] if done or total else []
        self.how_far = "".join(f", {part}" for part in (*parts, *(f"{name} {value}" for name, value in counts.items())))
        if now_s - self.told_s >= EVERY_S:
            self.told_s, spent_s, made = now_s, now_s - self.stage_s, done - self.first_done
            left = f", about {spent_s * (total - done) / made:.0f} s left" if made > 0 and done < total else ""
            LOG.info(f"{self.title}: {stage}{self.how_far}, {spent_s:.0f} s{left}")

    def _end_stage(self, now_s: float) -> None:
        if self.stage and now_s - self.stage_s >= EVERY_S:
            LOG.info(f"{self.title}: {self.stage}{self.how_far}: done in {now_s - self.stage_s:.1f} s")

    def finish(self) -> None:
        self._end_stage(time.perf_counter())
