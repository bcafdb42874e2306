"""What users get from studies: results that write themselves to a folder: tables, figures and report.md."""

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, ParamSpec, TypeVar

from jaxurban.checks import typed
from jaxurban.io.workspace import Workspace
from jaxurban.public import FactsRepr

Arguments = ParamSpec("Arguments")
Saved = TypeVar("Saved", bound="Result")


class Result(FactsRepr):
    """Base of the result of a study.

    Attributes:
      _command: that writes such results; a folder of one of another command is not replaced.
    """

    _command: ClassVar[str]

    def _outputs(self) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """Return what is written, by file name (`jaxurban.report.write.save`), and the settings that decide it."""
        raise NotImplementedError

    @typed
    def save(self, folder: str | Path, overwrite: bool = False) -> list[Path]:
        """Write the report, tables (CSV, Parquet), figures (PNG) and maps (GeoTIFF) of a study, and return the files.

        Args:
          folder: where to; made if it is not there.
          overwrite: replace another study of the kind in it.

        Raises:
          InputError: the folder cannot be written to, or holds another study or other files.
        """
        from jaxurban.report.write import files_of, save  # imports Matplotlib

        folder = Path(folder)
        outputs, settings = self._outputs()
        names = files_of(outputs)
        with Workspace.open(folder, self._command, settings, names=names, overwrite=overwrite):
            return save(folder, outputs)


def savable(
    study: Callable[Arguments, Any], kind: Callable[..., Saved]
) -> Callable[Arguments, Saved]:
    """Return a function that runs a study and returns its result as one that can be saved.

    Args:
      study: with any arguments.
      kind: class of the result that can be saved; it takes all attributes of what the study returns.
    """

    @functools.wraps(study)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Saved:
        """Run the study, and return its attributes as an object of the other class."""
        return kind(**vars(study(*args, **kwargs)))

    return run
