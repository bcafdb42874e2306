"""What every study found has in common: it shows itself in one line, and `save` writes it to a folder."""

from pathlib import Path

from jaxurban.errors import typed
from jaxurban.public import Shown


class Result(Shown):
    """Base of what a study found."""

    @typed
    def save(self, folder: str | Path, overwrite: bool = False) -> list[Path]:
        """Write the report, tables (CSV, Parquet), figures (PNG) and maps (GeoTIFF) of a study; return the files.

        Args:
          folder: where to; made if it is not there.
          overwrite: replace another study of the kind in it.

        Raises:
          InputError: the folder cannot be written to, or holds another study or other files.
        """
        from jaxurban.report.results import save_result

        return save_result(self, Path(folder), overwrite)
