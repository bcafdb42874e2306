"""Draw docs/gallery: run the Python of docs/gallery.md and keep the pictures that it shows, at the size of a screen."""

import contextlib
import re
import tempfile
from pathlib import Path

from PIL import Image

from jaxurban.draw.write import DPI

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "gallery.md"
SCREEN_DPI, QUALITY = 110, 60  # dots an inch of a page's width; of WebP


def shown() -> list[str]:
    """Return the pictures of the page, without their ends: each is the PNG of its name that the lines write."""
    return re.findall(r"\]\(gallery/(\S+)\.webp\)", PAGE.read_text(encoding="utf-8"))


def main() -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        exec("\n".join(blocks), {"__name__": "__main__"})
        for name in shown():
            with Image.open(f"{name}.png") as image:
                size = [round(side * SCREEN_DPI / DPI) for side in image.size]
                small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
            file = DOCS / "gallery" / f"{name}.webp"
            file.parent.mkdir(parents=True, exist_ok=True)
            small.save(file, quality=QUALITY, method=6)


if __name__ == "__main__":
    main()
