"""What users get from studies: results that write themselves to a folder: tables, figures and report.md."""

from pathlib import Path
from pkgutil import resolve_name
from typing import Any, ClassVar

from jaxurban.checks import typed
from jaxurban.io.workspace import Workspace
from jaxurban.public import FactsRepr


class Result(FactsRepr):
    """Base of the result of a study.

    Attributes:
      _command: that writes such results; a folder of one of another command is not replaced.
      _report: ``module:function``, which is imported when a result is saved, as it draws. The function returns the
        `jaxurban.draw.write.ResultReport` of a result.
    """

    _command: ClassVar[str]
    _report: ClassVar[str]

    @property
    def report(self) -> Any:
        """What `save` writes: the text, the tables and the figures (`jaxurban.draw.write.ResultReport`)."""
        return resolve_name(self._report)(self)

    @typed
    def save(self, folder: str | Path, overwrite: bool = False) -> list[Path]:
        """Write the report, tables (CSV, Parquet), figures (PNG) and maps (GeoTIFF) of a study, and return the files.

        Args:
          folder: where to; made if it is not there.
          overwrite: replace another study of the kind in it.

        Raises:
          InputError: the folder cannot be written to, or holds another study or other files.
        """
        folder = Path(folder)
        write = resolve_name("jaxurban.draw.write")
        report = self.report
        outputs = report.outputs
        names = write.files_of(outputs)
        with Workspace.open(folder, self._command, report.key, names=names, overwrite=overwrite):
            return write.save(folder, outputs)
