"""What a scenario adds to finished maps: altitudes, times, layers, and nothing else that differs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jaxurban.io.files import read_json
from jaxurban.io.store import RUN_FILE
from jaxurban.scenario.provenance import NOT_OF_MAPS, run_key, settings_of
from jaxurban.scenario.settings import Scenario
from jaxurban.world.show import listed

TIMES = ("times", "start", "stop", "step_s")  # settings of [gps] that name the times
LAYER_ROLE = "layer_"  # of the input files


@dataclass(frozen=True)
class Addition:
    """What is added to the maps of a folder.

    Attributes:
      key: of the run that made the maps that are there.
      before: its scenario.
      what: is added, in words.
    """

    key: str
    before: Scenario
    what: str


def addition_to(
    folder: Path, scenario: Scenario, inputs: Mapping[str, Mapping[str, str]], backend: str
) -> Addition | None:
    """Return what a scenario adds to the maps under a folder; None where anything else differs, or nothing.

    The values of maps depend neither on the other altitudes nor on the other times or layers that are made with them,
    as long as every time's maps are kept, so that what is there can stay.
    """
    try:
        held = read_json(folder / RUN_FILE)
        key, files, epochs = held["run_key"], held["inputs"], held["epochs"]
        before = Scenario.from_dict(held["settings"], folder=scenario.path_of(""))
    except (OSError, ValueError, LookupError):  # of another version, perhaps
        return None
    if run_key(before, files, backend) != key or _rest(before) != _rest(scenario):  # also of other code
        return None
    if any(inputs.get(role) != file for role, file in files.items()):
        return None
    altitudes_m = [z_m for z_m in scenario.region.altitudes_m if z_m not in before.region.altitudes_m]
    old_layers, now_layers = (settings_of(one).get("layers", {}) for one in (before, scenario))
    layers = [name for name in now_layers if name not in old_layers]
    times = scenario.gps.utc_times
    is_default = times is None and before.gps.utc_times is None
    if times is None and not is_default:
        return None
    new_times = [] if times is None else [time for time in times if time not in epochs]
    is_kept = (
        set(before.region.altitudes_m) <= set(scenario.region.altitudes_m)
        and (times is None or set(epochs) <= set(times))
        and all(now_layers.get(name) == layer for name, layer in old_layers.items())
        and all(role in files or role.startswith(LAYER_ROLE) for role in inputs)
    )
    keeps_times = all(
        one.gps.keeps_times(num) for one, num in ((before, len(epochs)), (scenario, len(times or epochs)))
    )
    if not (is_kept and keeps_times and (altitudes_m or layers or new_times)):
        return None
    added = [f"{z_m:g} m" for z_m in altitudes_m] + [f"layer {name!r}" for name in layers]
    return Addition(key, before, ", ".join([*added, *([listed(new_times)] if new_times else [])]))


def _rest(scenario: Scenario) -> dict:
    """Return the settings that maps depend on but for what can be added."""
    settings = {name: value for name, value in settings_of(scenario).items() if name not in (*NOT_OF_MAPS, "layers")}
    settings["region"] = {name: value for name, value in settings["region"].items() if name != "altitudes_m"}
    return settings | {"gps": {name: value for name, value in settings["gps"].items() if name not in TIMES}}
