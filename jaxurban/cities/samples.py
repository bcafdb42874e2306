"""sample_city: a real city that is in the package."""

from collections.abc import Sequence

from jaxurban.checks import typed
from jaxurban.io.city import City
from jaxurban.io.samples import PREFIX, check_sample
from jaxurban.settings import SampleName
from jaxurban.world.kinds import KindName


@typed
def sample_city(name: SampleName, *, kinds: Sequence[KindName] | None = None) -> City:
    """Return a real city that is in the package: no file and no network is needed.

    ``"lower-manhattan"`` is the paper's: 13,000 outlines and parts of OpenStreetMap (data of 2024-05-29, ODbL) in the
    box -74.031, 40.695, -73.968, 40.730, and what else stands there (11,251 trees, 20 woods, 115 flagpoles, 13 power
    lines, ...), with the 2010 census blocks, New York's community districts and GPS at 2020-04-27, 16:00 UTC (noon
    there).

    ``"shinjuku"`` is 2 x 2 km around the station in Tokyo: 53,000 roof planes of Project PLATEAU (2020, CC BY 4.0), all
    within 400 m of the region and farther away those that hide satellites above 5 degrees from some place in it, with
    GPS and Galileo at 2018-12-19, 03:00 UTC (noon there). It has no people. Coordinates are rounded to 1e-6 degrees,
    about 0.1 m, and heights to 0.1 m. The ground of all is flat, and the satellites of all stand in their nominal
    slots, not where the real ones stood: give ``gps`` elements of a day for these.

    ``"nihonbashi"`` is a drive of 1.65 km between towers in Tokyo, with a receiver's log (2023-06-22, 01:08:42 UTC on)
    that `jaxurban.studies.validate` sets beside the maps, and the roof planes of Project PLATEAU (2020, CC BY 4.0)
    within 300 m of it. Beyond, nothing is known: its maps are for this comparison, and for cells of 2 m. The source of
    both cities in Tokyo holds roofs alone: there is no tree, mast or wire.

    Maps of the first equal those of its sources, value by value. So do those of the second in its own region and from
    5 degrees up, but for the rounding, which moves 0.13 % of cells into or out of obstacles at 20 m.

    Args:
      name: ``"lower-manhattan"``, ``"shinjuku"`` or ``"nihonbashi"``.
      kinds: of what stands that count, as of `City.from_files`; left out, all.

    Returns:
      The city in the UTM zone of its region, metres. Maps of it are made for its own ``bounds`` (degrees) and
      satellites (``gps``) where no others are given. Pictures carry its ``attribution``, which the licences ask for.

    Warns:
      GuessWarning: of each of the city's ``guesses``.

    Raises:
      InputError: no such city; the message names the nearest one; an unknown kind.

    Examples:
      >>> import jaxurban as ju
      >>> city = ju.sample_city("shinjuku")
      >>> len(city.buildings) > 50_000, city.blocks is None
      (True, True)
      >>> ju.sample_city("lower-manhattan", kinds=["building"]).kinds
      ('building',)
    """
    check_sample(name)
    return City.from_files(f"{PREFIX}{name}", kinds=kinds)
