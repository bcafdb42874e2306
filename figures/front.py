"""Draw docs/studies/front.webp: what the recipe of docs/studies/sensitivity.md draws over Lower Manhattan."""

import contextlib
import re
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from PIL import Image

import jaxurban as ju

PAGE = Path(__file__).parents[1] / "docs" / "studies" / "sensitivity.md"
SCREEN_SHARE = 0.5  # of the dots that the recipe writes


def main() -> None:
    matplotlib.use("agg")
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    (places,) = re.findall(r"^places = dict\(.*\)$", "\n".join(blocks), re.M)
    (recipe,) = (block for block in blocks if "front.png" in block)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        city = ju.sample_city("lower-manhattan")
        ju.build_maps(city, resolution_m=5.0, altitudes_m=(20.0,)).save("out/manhattan")
        exec(f"{places}\n{recipe}", {"ju": ju, "np": np, "pd": pd})
        with Image.open("front.png") as image:
            size = [round(side * SCREEN_SHARE) for side in image.size]
            small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.save(PAGE.with_name("front.webp"), quality=80, method=6)


if __name__ == "__main__":
    main()
