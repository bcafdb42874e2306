"""What jaxurban says of flights over cities' files: here, or in another checkout, which runs this file as a script.

``python -P verdicts.py LIST.json`` prints a line of JSON for each city of a list of `verdicts_of`'s arguments.
"""

import json
import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jaxurban as ju
from jaxurban.settings import CLEARANCES

CELL_M, ALTITUDES_M = 20.0, (1.0, 260.0)
LIDAR = ju.Lidar(beams=1, azimuths=8, range_m=20.0)  # the least
GPS = ju.Gps(mask_deg=60.0)  # a few satellites, which nothing far away hides


@dataclass(frozen=True)
class Verdict:
    """What a check said: its state, ``"refused"`` or ``"crashed"``.

    Attributes:
      state: of the check.
      places: longitude and latitude of the findings.
      words: what was found and what was not judged, or the error.
    """

    state: str
    places: tuple[tuple[float, float], ...] = ()
    words: str = ""


def verdicts_of(
    city: str | Path, bounds: Sequence[float], crs: str, flights: Sequence[tuple[str, Any]]
) -> list[Verdict]:
    """Return what checks of flights, files and options, say over a city's file, whose maps are made for it."""
    try:
        made = ju.City.from_files(str(city), bounds=bounds, crs=crs)
        how = {"resolution_m": CELL_M, "altitudes_m": ALTITUDES_M, "lidar": LIDAR, "gps": GPS}
        maps = ju.build_maps(made, **how, progress=False)
        return [_verdict_of(maps, made, file, options) for file, options in flights]
    except ju.InputError as error:
        return [Verdict("refused", words=str(error))] * len(flights)
    except Exception as error:  # of any kind: none may leave a reader
        return [Verdict("crashed", words=repr(error))] * len(flights)


def _verdict_of(maps: ju.MetricMaps, city: ju.City, file: str, options: Any) -> Verdict:
    rules = {name: options.pop(name) for name in CLEARANCES}
    constraints = ju.Constraints.read(**rules)
    result = ju.check(
        maps, file, heights="ground", sources=city, constraints=constraints, **options
    )
    found = result.findings
    words = "; ".join([*found["what"], *result.not_judged])
    return Verdict(result.state, tuple(zip(found["lon"], found["lat"], strict=True)), words)


def main() -> None:
    """Print the verdicts of a list."""
    warnings.simplefilter("ignore")
    for asked in json.loads(Path(sys.argv[1]).read_text()):
        print(json.dumps([asdict(verdict) for verdict in verdicts_of(*asked)]), flush=True)


if __name__ == "__main__":
    main()
