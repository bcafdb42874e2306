"""The paper's figures and tables: each has its script, what it drew, and a caption beside it."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from figures import gallery
from figures.paper import common, example_paths
from jaxurban import plot as figures
from jaxurban.draw.frame import MapPanel, classes_layer, draw_maps
from jaxurban.world.grid import Grid

ROOT = Path(__file__).parents[1]
PAPER = ROOT / "figures" / "paper"
SCRIPTS = sorted([*PAPER.glob("fig_*.py"), *PAPER.glob("table_*.py")])
CAPTION = common.Caption("What it shows. " * 20, "What we see. " * 20, "Why they differ. " * 20)
GRID = Grid("EPSG:32618", 10.0, 450_000, 58_000, 60, 50)


def test_every_figure_and_table_of_the_paper_but_the_diagram_has_one_script():
    tex = common.DATA.parent / "paper" / "urban-metric-maps.tex"
    figures, tables = 13, 7
    if tex.exists():
        text = tex.read_text(encoding="utf-8")
        figures, tables = (
            len(re.findall(rf"\\begin{{{kind}\*?}}", text)) for kind in ("figure", "table")
        )
    numbers = [
        (kind, int(number)) for kind, number in (script.stem.split("_")[:2] for script in SCRIPTS)
    ]
    assert sorted(numbers) == [("fig", n) for n in range(2, figures + 1)] + [
        ("table", n) for n in range(1, tables + 1)
    ]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_names_its_figure_and_what_it_drew_is_small(script):
    kind, number = script.stem.split("_")[:2]
    first = script.read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith(
        f'"""{"Figure" if kind == "fig" else "Table"} {int(number)} of the paper: '
    )
    drawn = [path for path in PAPER.glob(f"{script.stem}*") if path.suffix in {".png", ".md"}]
    assert drawn, f"{script.stem} drew nothing that is kept"
    assert max(path.stat().st_size for path in drawn) < 300_000
    for table in (path for path in drawn if path.suffix == ".md"):
        text = table.read_text(encoding="utf-8")
        assert all(f"**{head}.** " in text for head in common.HEADS)
        assert all(
            line.endswith((".", ")", "|")) for line in text.splitlines() if line and line[0] != "#"
        )


def test_a_window_shows_the_grid_where_it_is_and_nothing_beyond():
    layer = classes_layer(
        np.arange(GRID.num_rows * GRID.num_cols).reshape(GRID.shape) % 7, list("rgbcmyk")
    )
    part = replace(
        GRID, first_row=GRID.first_row - 5, first_col=GRID.first_col + 30, num_rows=40, num_cols=40
    )
    shown = example_paths.crop(layer, GRID, part).values
    assert np.array_equal(shown[5:, :20], layer.values[:35, 30:])
    assert (shown[:5] == -1).all()
    assert (shown[:, 20:] == -1).all()
    plain = layer._replace(values=layer.values.astype(np.float32))
    assert np.isnan(example_paths.crop(plain, GRID, part).values[:5]).all()


@pytest.mark.slow
def test_a_figure_is_drawn_for_the_eye_and_for_print_and_a_small_one_is_kept_apart(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(common, "HERE", tmp_path)
    monkeypatch.setattr(common, "OUT", tmp_path / "print")
    common.save(draw_maps(GRID, [MapPanel("a")], "Heading", "note")[0], "fig_99_try", CAPTION)
    assert (tmp_path / "fig_99_try.png").read_bytes()[:4] == b"\x89PNG"
    text = (tmp_path / "fig_99_try.md").read_text(encoding="utf-8")
    assert all(
        f"**{head}.** {said}" in text for head, said in zip(common.HEADS, CAPTION, strict=True)
    )
    assert (tmp_path / "print" / "fig_99_try.pdf").read_bytes()[:4] == b"%PDF"
    monkeypatch.setattr(common, "IS_SMALL", True)
    assert common.folder() == common.OUT


def test_the_gallery_shows_every_function_and_keeps_what_its_page_shows():
    text, names = gallery.PAGE.read_text(encoding="utf-8"), gallery.shown()
    # Those of studies are drawn by their commands, into the folders that the page shows; a city's is like its maps'.
    of_maps = "jaxurban.draw", "jaxurban.flights"
    draws = {
        name
        for name in dir(figures)
        if name.startswith("plot_") and getattr(figures, name).__module__.startswith(of_maps)
    } - {"plot_city"}
    assert [name for name in draws if f"figures.{name}(" not in text] == []
    kept = {
        file.relative_to(gallery.DOCS / "gallery").with_suffix("").as_posix(): file.stat().st_size
        for file in (gallery.DOCS / "gallery").rglob("*.webp")
    }
    assert sorted(kept) == sorted(names)
    assert max(kept.values()) < 300_000
    assert sum(kept.values()) < 1_500_000


def test_the_gallery_draws_what_the_lines_of_its_page_write(tmp_path, monkeypatch):
    lines = """```python
from jaxurban.draw.style import chart
chart(2.0, "Two").savefig("two.png")
```
![two](gallery/two.webp)
"""
    (tmp_path / "gallery.md").write_text(lines, encoding="utf-8")
    monkeypatch.setattr(gallery, "DOCS", tmp_path)
    monkeypatch.setattr(gallery, "PAGE", tmp_path / "gallery.md")
    gallery.main()
    with Image.open(tmp_path / "gallery" / "two.webp") as image:
        assert image.size[0] == pytest.approx(182 / 25.4 * gallery.SCREEN_DPI, abs=1)


def test_an_unknown_figure_is_answered_with_those_there_are():
    done = subprocess.run(
        [sys.executable, "-m", "figures", "nosuch"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "no figure has nosuch in its name" in done.stderr
    assert "fig_06_gps" in done.stderr
