"""Texts of a folder that someone else made stay texts: on the page, in notebooks, in pictures and in reports."""

import json
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pyproj
import pytest

import jaxurban as ju
from jaxurban.draw.metrics import plot_metric
from jaxurban.draw.write import bullets, code, fill, plain, table
from jaxurban.draw.write import write_picture as write
from jaxurban.errors import InputError
from jaxurban.flights.report import check_report
from jaxurban.io.files import write_json
from jaxurban.knowledge import Guess, GuessKind
from jaxurban.metrics.custom import Layer
from jaxurban.paths.route_report import short
from jaxurban.public import Caution
from jaxurban.studies.reports.map_comparison import comparison_report
from jaxurban.studies.reports.sensitivity import sensitivity_report
from jaxurban.viewer.html import write_page
from jaxurban.viewer.sky import sky_html
from jaxurban.viewer.viewer import Viewer
from jaxurban.viewer.widget import reply_to
from jaxurban.world.grid import Grid, crs_said
from tests.guess_records import attribute, heights
from tests.made_maps import city_of_boxes, made_maps
from tests.pictures import PICTURE, SVG, pictures_in

HTML = "<img src=x onerror=alert(1)>\"'`tick`</script>"
HOSTILE = f"{HTML} | b\n\n# heading [c](http://nowhere) $x_$"
SKY, AT = "sample:shinjuku/gps.tle", "2018-12-19T03:00:00Z"
FREE = np.argwhere(made_maps(24, 30).is_free(20.0))


def crs_named(name: str) -> str:
    """Return UTM 18N as WKT under another name, with its quotes doubled as WKT has them."""
    wkt = pyproj.CRS("EPSG:32618").to_wkt()
    return wkt.replace("WGS 84 / UTM zone 18N", name.replace('"', '""').replace("\n", " "), 1)


def hostile_maps() -> ju.MetricMaps:
    """Return maps all of whose texts are hostile."""
    layer = Layer(source="a.tif", scale=(0.0, 1.0), cost="high-is-bad").record
    attrs = {
        "crs": crs_named(HOSTILE),
        "attribution": HOSTILE,
        **attribute(heights(0.5, HOSTILE), Guess(GuessKind.EMPTY_LAYER, facts={"layer": HOSTILE})),
        "constellations": HOSTILE,
        "settings": json.dumps({"gps": {"orbits": [HOSTILE]}, "planning": {}}),
    }
    ds = made_maps(24, 30).ds.assign_attrs(attrs)
    texts = {"long_name": HOSTILE, "units": HOSTILE, "one_means": HOSTILE, "caveat": HOSTILE}
    ds = ds.assign({HOSTILE: ds["roof"].assign_attrs(texts), f"layer {HTML}": ds["risk"][0]})
    ds[f"layer {HTML}"].attrs = texts | {"layer": json.dumps(layer)}
    ds["gps"].attrs = ds["risk"].attrs = texts
    times_of_day = np.array([HOSTILE, f"night{HTML}"], np.dtypes.StringDType())
    return ju.MetricMaps(ds.assign_coords(time_of_day=times_of_day))


pytestmark = [
    pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning"),
    pytest.mark.usefixtures("without_layout"),
]


@pytest.fixture(scope="module")
def maps():
    return hostile_maps()


def ends(maps: ju.MetricMaps) -> list[list[float]]:
    return [np.round(maps.grid.lonlat_of_cell(*FREE[at]), 7).tolist() for at in (5, -9)]


def check_html(text: str) -> None:
    """Check that no element and no attribute comes of a hostile text, beside those of the pictures of the page."""
    for drawn in pictures_in(text):
        assert not {element.tag.removeprefix(SVG) for element in drawn.iter()} & {"img", "script"}
    text = PICTURE.sub("", text)
    parser = HTMLParser()
    met = []
    parser.handle_starttag = lambda tag, attrs: met.extend([tag, *(name for name, _ in attrs)])
    parser.handle_endtag = met.append
    parser.feed(text)
    assert not {"img", "script", "onerror", "src"} & {*met}


def check_markdown_harmless(text: str) -> None:
    check_html(text)
    for harm in ("<img", "`tick`", "| b", "\n# heading", "](http"):
        assert harm not in text


def test_no_text_of_maps_is_markup_on_the_page(maps):
    viewer = Viewer(maps, name=HOSTILE)
    start, goal = ends(maps)
    weights = dict.fromkeys(["distance", *maps.metrics], 1.0)
    plan = {"start": start, "goal": goal, "at": [0, 0, 0], "weights": weights}
    found = {"scene": {}, "plan": plan, "report": plan}
    answers = {name: json.loads(viewer.answer(name, query).body) for name, query in found.items()}
    scene = answers["scene"]["html"]
    assert "&lt;img" in scene["place"]
    layer = max(viewer.layers, key=len)
    view = {"layer": layer, "at": [0, 0, 0]}
    legend = json.loads(viewer.answer("legend", view).body)["html"]
    report = answers["report"]
    of_report = [report[name] for name in ("cautions", "totals", "profile", "saved", "report-text")]
    of_plan = [answers["plan"][name] for name in ("button", "html")]
    for text in [*scene.values(), legend, *of_report, *of_plan]:
        check_html(text)
    assert "&lt;img" in legend
    assert "&lt;img" in "".join(of_report)
    reply, _ = reply_to(viewer, {"id": 1, "name": "scene", "parameters": {}})
    assert reply["json"]["html"] == scene


def test_no_text_of_maps_ends_the_script_of_an_exported_page(maps, tmp_path):
    write_page(Viewer(maps, name=HOSTILE), tmp_path / "page.html", 10**8)
    page = (tmp_path / "page.html").read_text()
    assert "<img src=x" not in page
    assert page.count("</script>") == 2


def test_no_text_of_maps_or_skies_is_markup_in_a_notebook(maps):
    start, goal = ends(maps)
    path = ju.plan(maps, start, goal, altitude_m=20.0, snap=True)
    for shown in (maps, path, ju.explain(path, maps)):
        check_html(shown._repr_html_())
    city = city_of_boxes([(10.0, 10.0, 20.0, 20.0)], 30.0, 200.0, (583_000.0, 4_507_000.0))
    sky = ju.sky(city, ju.XY(583_100.0, 4_507_100.0), 20.0, gps=ju.Gps(orbits=SKY, times=AT))
    table = sky.table.assign(satellite=HOSTILE, system=HOSTILE)
    sky = replace(sky, table=table, attribution=HOSTILE, cautions=[Caution(HOSTILE, "guess")])
    check_html(sky_html(sky))
    check_html(sky._repr_html_())


def test_no_text_of_maps_is_markup_in_a_picture(maps, tmp_path):
    figure = plot_metric(maps, "risk", altitude_m=20.0)
    write(figure, tmp_path / "risk.svg")
    root = ElementTree.parse(tmp_path / "risk.svg").getroot()
    names = {element.tag.rpartition("}")[2] for element in root.iter()}
    assert not names & {"img", "script"}


@pytest.mark.slow
def test_no_text_of_maps_is_markup_in_a_report(maps, tmp_path):
    start, goal = ends(maps)
    path = ju.plan(maps, start, goal, altitude_m=20.0, snap=True)
    comparison = ju.studies.compare(maps, maps, progress=False)
    comparison = replace(
        comparison,
        table=comparison.table.replace({"layer": {"risk": f"layer {HTML}"}}).assign(higher=1),
        names=(HOSTILE, HOSTILE),
        left_out={HOSTILE: HOSTILE},
        settings={HOSTILE: (HOSTILE, HOSTILE)},
    )
    settings = ju.studies.SensitivitySettings(vary=("gps",))
    where = tmp_path / "sensitivity", [(start, goal)]
    changed = ju.studies.sensitivity(
        maps, *where, altitudes_m=[20.0], settings=settings, progress=False
    )
    changed = replace(changed, skipped=(HOSTILE,))
    mission = json.loads('{"type": "FeatureCollection", "features": []}')
    lonlat = [[*place, 20.0] for place in path.lonlat.tolist()]
    geometry = {"type": "LineString", "coordinates": lonlat}
    mission["features"] = [{"type": "Feature", "properties": {}, "geometry": geometry}]
    file = tmp_path / "a<img src=x>`tick`|b.geojson"
    write_json(file, mission)
    judged = ju.check(maps, file, heights="ground")
    judged = replace(judged, not_judged=(HOSTILE,))
    texts = [
        comparison_report(comparison).text,
        sensitivity_report(changed).text,
        check_report(judged).text,
    ]
    for text in texts:
        check_markdown_harmless(text)
        assert "&lt;img" in text


def test_what_a_template_is_filled_with_is_text_unless_it_is_markdown():
    fit = SimpleNamespace(num_tested=HTML)
    text = fill("studies/templates/held_out", credits=[HOSTILE], num=HOSTILE, fit=fit)
    check_markdown_harmless(text)
    assert plain(text) == text
    for part in (table([HOSTILE], [[HOSTILE]]), bullets([HOSTILE]), code(HOSTILE), plain(HOSTILE)):
        check_markdown_harmless(part)
    assert table(["a"], [[HOSTILE]]).count("|") == 6
    assert plain("m_gps, 2 > 1 and [0, 1]") == "m_gps, 2 > 1 and [0, 1]"
    command = 'jaxurban tune DIR --wish "people <= 0.5" --wish "detour<=0.1"'
    assert code(command) == f"`{command}`"
    assert plain("<=<b> < </b><") == "<=&lt;b> < &lt;/b>&lt;"
    assert table(["a"], [[bullets(["`b`"])]]).splitlines()[2] == "| - 'b' |"


def test_a_definition_of_a_crs_is_named_in_short_and_no_message_repeats_a_text_of_any_length():
    grid = Grid(crs_named("my zone"), 10.0, 450_000, 58_000, 4, 4)
    assert crs_said(grid.crs) == "my zone"
    assert crs_said("EPSG:32618") == "EPSG:32618"
    with pytest.raises(InputError) as caught:
        Grid("X" * 10**6, 10.0, 0, 0, 4, 4)
    assert len(str(caught.value)) < 2100
    assert str(caught.value).endswith("such as 'EPSG:32618'")


def test_numbers_just_below_a_thousand_have_no_power_of_ten():
    values = [999.4, 999.7, 1000.2, -999.7, 99.96]
    assert [short(value) for value in values] == ["999", "1,000", "1,000", "-1,000", "100"]
    assert table(["m"], [[999.7]]) == "| m |\n|---|\n| 1000 |"
