"""What whoever publishes maps cites, and whom they credit."""

from importlib.metadata import version
from typing import Literal

from jaxurban.checks import typed
from jaxurban.maps.metric_maps import MapsLike, as_maps

# As in CITATION.cff.
SOFTWARE = "The jaxurban authors: jaxurban: urban metric maps and path planning for small drones"
PAPER = (
    "Cosme A. Ochoa, Ella M. Atkins: Urban Metric Maps for Small Unmanned Aircraft Systems Motion Planning, "
    "https://doi.org/10.48550/arXiv.2102.07218"
)


BIBTEX = """@software{{jaxurban,
  author = {{{{The jaxurban authors}}}},
  title = {{{{jaxurban}}: urban metric maps and path planning for small drones}},
  version = {{{version}}},
}}
@misc{{ochoa2021,
  author = {{Ochoa, Cosme A. and Atkins, Ella M.}},
  title = {{Urban Metric Maps for Small Unmanned Aircraft Systems Motion Planning}},
  year = {{2021}},
  eprint = {{2102.07218}},
  archivePrefix = {{arXiv}},
  doi = {{10.48550/arXiv.2102.07218}},
}}"""


@typed
def cite(maps: MapsLike | None = None, form: Literal["text", "bibtex"] = "text") -> str:
    """Return what to cite beside maps and routes on them: the software, the paper, the credit of the data.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder. Without them, and without a credit, as of data of your
        own, the last line is left out.
      form: ``"text"``, a line each, or ``"bibtex"``, two entries, with the credit as a line of text after them.

    Returns:
      The text. Its version is that of the jaxurban that runs; ``run.json`` beside the maps holds that which made them.

    Raises:
      InputError: a folder without maps.

    Examples:
      >>> print(ju.cite(maps).splitlines()[-1])
      Data: ...
    """
    credit = "" if maps is None else as_maps(maps).attribution
    data = f"\nData: {credit}." if credit else ""
    running = version("jaxurban")
    if form == "bibtex":
        return BIBTEX.format(version=running) + data
    return f"{SOFTWARE}, version {running}.\n{PAPER}.{data}"
