"""What jaxurban says of missions' files: here, or in another checkout, which runs this file as a script.

``python -P verdicts.py LIST.json`` prints a line of JSON for each mission of a list of `verdict_of`'s arguments.
"""

import json
import sys
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jaxurban as ju
from jaxurban.settings import CLEARANCES

PLACE = ["lon", "lat", "height_m"]


@dataclass(frozen=True)
class Verdict:
    """What a check said: its state, ``"refused"`` or ``"crashed"``.

    Attributes:
      state: of the check.
      kinds: of the findings.
      places: longitude, latitude and height above the ground of the findings.
      words: what was found and what was not judged, or the error.
    """

    state: str
    kinds: tuple[str, ...] = ()
    places: tuple[tuple[float, ...], ...] = ()
    words: str = ""


def verdict_of(maps: ju.MetricMaps, file: str | Path, options: Mapping[str, Any]) -> Verdict:
    """Return what a check of a mission's file over maps says."""
    try:
        rules = {name: options[name] for name in CLEARANCES if name in options}
        others = {name: value for name, value in options.items() if name not in rules}
        result = ju.check(maps, file, constraints=ju.Constraints.read(**rules), **others)
    except ju.InputError as error:
        return Verdict("refused", words=str(error))
    except Exception as error:  # of any kind: none may leave a check
        return Verdict("crashed", words=repr(error))
    found = result.findings
    words = "; ".join([*found["what"], *result.not_judged])
    places = found[PLACE].to_numpy(float).tolist()
    return Verdict(result.state, tuple(found["kind"]), tuple(map(tuple, places)), words)


def main() -> None:
    """Print the verdicts of a list."""
    warnings.simplefilter("ignore")
    opened = {}
    for folder, resolution_m, file, options in json.loads(Path(sys.argv[1]).read_text()):
        key = folder, resolution_m
        opened[key] = opened.get(key) or ju.open_maps(folder, resolution_m)
        print(json.dumps(asdict(verdict_of(opened[key], file, options))), flush=True)


if __name__ == "__main__":
    main()
