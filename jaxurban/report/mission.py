"""MissionCheck: the check of a mission, which writes itself to a folder or a file."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxurban.checks import typed
from jaxurban.io.files import write_whole
from jaxurban.io.tables import SUFFIXES, write_table
from jaxurban.report.results import Result, savable
from jaxurban.studies import check as computed
from jaxurban.studies import check_result


class MissionCheck(check_result.MissionCheck, Result):
    """What a check of a mission found.

    Attributes:
      findings: a row each: ``kind`` (``"building"``, ``"terrain"``, ``"zone"``, ``"closed"`` or ``"limit"``),
        ``what``, ``item`` (in the file, flown toward), ``lon`` and ``lat`` of the first contact, ``along_m`` and
        ``to_m`` along the mission, ``height_m`` above the ground there, ``building_m`` (the roof's height), ``by_m``
        (metres inside, below the ground or short of the clearance; of a limit, beyond it) and ``is_guessed``.
      not_judged: sentences.
      figures: lengths, metres without a fix, people, cost and exposure; ``cost_note`` says what is missing.
      outlines: ``"exact"``, or ``"by cells"`` where the city behind the maps is gone.
      limits: the constraints, as `Constraints.to_dict` has them.
      flight: the mission over the maps.
      maps: the maps.

    Examples:
      >>> path.save("mission.plan").name
      'mission.plan'
      >>> ju.check(maps, "mission.plan", sources=city)
      MissionCheck(state: Findings: 1.; mission: mission.plan; buildings: exact outlines; ...
        limit: Flies up to 7.8 m into a building: from 831 to 839 m along the mission, toward item 7, at ...
    """

    _command = "check"

    def _outputs(self) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """Return what a check writes, by file name, and what it is of."""
        from jaxurban.report.check import check_outputs  # imports Matplotlib

        return check_outputs(self)

    @typed
    def save(self, folder: str | Path, overwrite: bool = False) -> list[Path]:
        """Write the page, the record and the findings to a folder, or the findings alone to a file; return the files.

        Args:
          folder: where to, made if it is not there; or a ``.geojson``, ``.csv`` or ``.parquet`` file.
          overwrite: replace another check in the folder.

        Returns:
          The files. The page is ``report.md``, with a map and a profile.

        Raises:
          InputError: the folder cannot be written to, or holds another study or other files.

        Examples:
          >>> path.save("mission.plan").name
          'mission.plan'
          >>> result = ju.check(maps, "mission.plan", sources=city)
          >>> [file.name for file in result.save("findings.geojson")]
          ['findings.geojson']
          >>> sorted(file.name for file in result.save("checked"))[:3]
          ['check.json', 'findings.csv', 'findings.geojson']
        """
        file = Path(folder)
        if file.suffix == ".geojson":
            write_whole(file, json.dumps(self.to_geojson(), indent=1))
        elif file.suffix in SUFFIXES:
            write_table(self.findings, file)
        else:
            return super().save(folder, overwrite)
        return [file]


check = savable(computed.check, MissionCheck)
