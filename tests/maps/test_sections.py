"""What sections of a scenario ask for: metrics on request, other maps under another key, and wrong ones refused."""

import pytest

from jaxurban.errors import InputError
from jaxurban.maps.provenance import run_key
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.protection import Protection
from jaxurban.metrics.registry import ON_REQUEST
from jaxurban.world.city import SLABS, TO_GROUND

BOUNDS = [-74.02, 40.70, -73.98, 40.73]


def of(**sections) -> Scenario:
    return Scenario.from_dict({"region": {"bounds": BOUNDS}, "buildings": {"source": "x.osm"}} | sections)


def hanging(how: str) -> dict:
    return {"buildings": {"source": "x.osm", "hanging": how}}


def test_a_runs_key_tells_clocks_metrics_and_slabs_apart():
    others = {"gps": {"clocks": "one"}}, {"gps_horizontal": {}}, hanging(SLABS)
    plain, same, *keys = (run_key(of(**more), {}, "cpu") for more in ({}, hanging(TO_GROUND), *others))
    assert same == plain
    assert len({plain, *keys}) == 1 + len(others)


@pytest.mark.parametrize("name", ON_REQUEST)
def test_a_section_or_a_weight_asks_for_a_metric_on_request(name):
    for sections, is_there in (({}, 0), ({name: {}}, 1), ({"weights": {name: 2.0}}, 1), ({"weights": {name: 0}}, 0)):
        scenario = of(**sections)
        assert getattr(scenario, name) == (ON_REQUEST[name].params() if is_there else None)
        assert (name in scenario.map_params.sections) == (f"[{name}]" in scenario.to_toml()) == bool(is_there)
        assert is_there or name not in scenario.model_dump()
    assert of(protection={"horizontal_alert_limit_m": 25}).protection == Protection(horizontal_alert_limit_m=25.0)


@pytest.mark.parametrize(
    ("sections", "words"),
    [
        ({"protection": {"p_sat": 2}}, r"protection.*p_sat must be a probability"),
        (hanging("floating"), r"buildings\.hanging"),
        ({"region": {"bounds": BOUNDS, "oversample": 4}, "gps": {"bounds": True}}, "odd oversample"),
    ],
)
def test_a_wrong_section_is_one_sentence(sections, words):
    with pytest.raises(InputError, match=words):
        of(**sections)
