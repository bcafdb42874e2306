"""Writing what a study found to a folder of its own: tables, figures and report.md."""

from pathlib import Path
from typing import Any

from jaxurban.io.workspace import Workspace
from jaxurban.report.check import check_outputs
from jaxurban.report.map_comparison import comparison_outputs
from jaxurban.report.montecarlo import BenchmarkResult, analysis_outputs
from jaxurban.report.receiver import validation_outputs
from jaxurban.report.sensitivity import sensitivity_outputs
from jaxurban.report.write import files_of, save
from jaxurban.studies.check_result import MissionCheck
from jaxurban.studies.map_comparison import MapComparison
from jaxurban.studies.queries import Result
from jaxurban.studies.receiver.validate import ReceiverValidation
from jaxurban.studies.weights.study import Sensitivity

KINDS: dict[
    type[Result], tuple[str, Any]
] = {  # the command, and what returns the files and what decides them
    BenchmarkResult: ("study", analysis_outputs),
    MissionCheck: ("check", check_outputs),
    MapComparison: ("compare", comparison_outputs),
    ReceiverValidation: ("validate", validation_outputs),
    Sensitivity: ("sensitivity", sensitivity_outputs),
}


def save_result(found: Result, folder: Path, overwrite: bool) -> list[Path]:
    """Write what `jaxurban.studies.queries.Result.save` says."""
    command, outputs_of = KINDS[type(found)]
    outputs, settings = outputs_of(found)
    with Workspace.open(folder, command, settings, names=files_of(outputs), overwrite=overwrite):
        return save(folder, outputs)
