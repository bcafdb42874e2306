"""Files that come into a folder all together or not at all, and over nobody else's."""

import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxurban.errors import InputError, reason_of
from jaxurban.io.files import ELSEWHERE, SCRATCH_SUFFIX
from jaxurban.io.workspace import Workspace

RECORD_FILE = "fetch.json"
SCENARIO_FILE = "scenario.toml"
STAGE_PREFIX = ".fetch."
REMEDY = f"{ELSEWHERE}, or pass --overwrite, which keeps it under another name"


@contextmanager
def staged(folder: Path, names: Collection[str], *, overwrite: bool) -> Iterator[Path]:
    """Yield a scratch folder whose files move into ``folder`` if the block succeeds, the scenario last.

    Args:
      folder: where to; made if it is not there.
      names: the files that may come.
      overwrite: set aside what is there under these names; else only what an earlier fetch wrote, and nobody changed,
        may be there.

    Raises:
      InputError: a file of these names is in the way, or the folder cannot be written to.
    """
    if blocked := [folder / name for name in names if (folder / name).is_dir()]:
        raise InputError(f"a folder is in the way of the file {str(blocked[0])!r}: move it, or {ELSEWHERE}")
    with Workspace.open(folder, "fetch", is_shared=True) as workspace:
        if not overwrite:
            workspace.check_way((folder / name for name in names), REMEDY)
        for scrap in folder.glob(f"{STAGE_PREFIX}*{SCRATCH_SUFFIX}"):  # of a killed run
            shutil.rmtree(scrap, ignore_errors=True)
        stage = Path(tempfile.mkdtemp(SCRATCH_SUFFIX, STAGE_PREFIX, folder))
        try:
            yield stage
            for path in sorted(stage.iterdir(), key=lambda path: path.name == SCENARIO_FILE):
                target = folder / path.name
                try:
                    if overwrite and os.path.lexists(target) and not workspace.is_own(target):
                        workspace.set_aside(target)
                    workspace.put(path, target)
                except OSError as error:
                    raise InputError(f"cannot write {str(target)!r} ({reason_of(error)}): {ELSEWHERE}") from error
        finally:
            shutil.rmtree(stage, ignore_errors=True)
