"""What whoever publishes maps cites, and whom they credit."""

from importlib.metadata import version

from jaxurban.checks import typed
from jaxurban.maps.metric_maps import MapsLike, as_maps

# As in CITATION.cff.
SOFTWARE = "The jaxurban authors: jaxurban: urban metric maps and path planning for small drones"
PAPER = (
    "Cosme A. Ochoa, Ella M. Atkins: Urban Metric Maps for Small Unmanned Aircraft Systems Motion Planning, "
    "https://doi.org/10.48550/arXiv.2102.07218"
)


@typed
def cite(maps: MapsLike) -> str:
    """Return what to cite beside maps and routes on them, a line each: the software, the paper, the credit of the data.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder. Without a credit, as of data of your own, that line is
        left out.

    Returns:
      The text. Its version is that of the jaxurban that runs; ``run.json`` beside the maps holds that which made them.

    Raises:
      InputError: a folder without maps.

    Examples:
      >>> print(ju.cite(maps).splitlines()[-1])
      Data: ...
    """
    credit = as_maps(maps).attribution
    data = f"\nData: {credit}." if credit else ""
    return f"{SOFTWARE}, version {version('jaxurban')}.\n{PAPER}.{data}"
