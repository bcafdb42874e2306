"""The public sources that `jaxurban fetch` knows: where they are, whose they are, and how they want requests."""

import os
import string
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from urllib.parse import quote, urlsplit

from jaxurban.errors import InputError, one_of
from jaxurban.world.grid import Bounds

ENVIRONMENT_PREFIX = "JAXURBAN_SOURCE_"  # JAXURBAN_SOURCE_OSM=https://a.mirror/...
HOUR_S = 3600.0
DAY_S = 24 * HOUR_S
MOST_OVERPASS_KM2 = 100.0  # a dense city of this size is some 200 MB of XML and a minute of a shared server's time
CENSUS_YEARS = ("2020", "2010")


@dataclass(frozen=True)
class Source:
    """A public source.

    Attributes:
      name: what users call it (``--source name=URL``).
      url: template; what stands in braces is filled in for the region.
      placeholders: what may stand in braces.
      credit: who made it.
      licence: its terms, in a few words.
      fresh_s: a copy younger than this is used without a request.
      num_tries: how many requests a busy server gets.
      is_given: whether the user named another place for it.
    """

    name: str
    url: str
    placeholders: tuple[str, ...]
    credit: str
    licence: str
    fresh_s: float
    num_tries: int = 4
    is_given: bool = False

    def fill(self, box: Bounds | None = None, **values: str) -> str:
        """Return the URL; ``box`` is west, south, east, north in degrees."""
        if box is not None:
            values |= {name: f"{value:.6f}" for name, value in zip(BOX, box, strict=True)}
        return self.url.format(**values)


BOX = ("west", "south", "east", "north")
TIGERWEB = (
    "https://tigerweb.geo.census.gov/arcgis/rest/services/TIGERweb/tigerWMS_Census{year}/MapServer/{layer}/query"
    "?where=1%3D1&geometry={west},{south},{east},{north}&geometryType=esriGeometryEnvelope&inSR=4326"
    "&spatialRel=esriSpatialRelIntersects&outFields=GEOID,POP100&returnGeometry=false&orderByFields=GEOID"
    "&resultOffset={offset}&f=json"
)
BLOCK_LAYER = MappingProxyType({"2020": "10", "2010": "18"})  # the blocks' number in TIGERweb's map of each census
BLOCK_FILES = MappingProxyType(
    {
        "2020": "https://www2.census.gov/geo/tiger/TIGER2020PL/LAYER/TABBLOCK/2020/tl_2020_{county}_tabblock20.zip",
        "2010": "https://www2.census.gov/geo/tiger/TIGER2010/TABBLOCK/2010/tl_2010_{county}_tabblock10.zip",
    }
)
CENSUS_CREDIT = ("U.S. Census Bureau", "public domain (U.S. government work)")


def sources_of(census_year: str, given: Mapping[str, str]) -> dict[str, Source]:
    """Return the sources by name: the known ones, or the places that are ``given`` or that the environment names.

    The Census Data API asks for a personal key; TIGERweb, which holds the same counts by block, does not. CelesTrak
    updates every two hours and wants programs to stop at the first refusal; two-line elements cannot name satellites
    catalogued since 2026, so its OMM (CSV) is asked for.

    Args:
      census_year: of `CENSUS_YEARS`.
      given: URL templates by source.

    Raises:
      InputError: another year, an unknown source, a URL that is not http(s), or an unknown placeholder.
    """
    one_of("the census year", census_year, CENSUS_YEARS)
    counts = TIGERWEB.replace("{year}", census_year).replace("{layer}", BLOCK_LAYER[census_year])
    sources = (
        Source(
            "osm",
            "https://overpass-api.de/api/interpreter?data={query}",
            (*BOX, "query"),
            "© OpenStreetMap contributors",
            "ODbL 1.0: keep the credit, share changed data alike",
            DAY_S,
        ),
        Source("population", counts, (*BOX, "offset"), *CENSUS_CREDIT, 30 * DAY_S),
        Source("blocks", BLOCK_FILES[census_year], ("county",), *CENSUS_CREDIT, 30 * DAY_S),
        Source(
            "districts",
            "https://services5.arcgis.com/GfwWNkhOj9bNBqoJ/arcgis/rest/services/NYC_Community_Districts/FeatureServer"
            "/0/query?where=1%3D1&outFields=*&outSR=4326&f=pgeojson",
            (),
            "New York City Department of City Planning",
            "NYC Open Data terms",
            30 * DAY_S,
        ),
        Source(
            "orbits",
            "https://celestrak.org/NORAD/elements/gp.php?GROUP=gps-ops&FORMAT=csv",
            (),
            "CelesTrak (T. S. Kelso), from 18th Space Defense Squadron data",
            "free; once in two hours at most",
            2 * HOUR_S,
            num_tries=1,
        ),
    )
    by_name = {source.name: source for source in sources}
    environment = {name: os.environ.get(ENVIRONMENT_PREFIX + name.upper(), "") for name in by_name}
    for name, url in ({name: url for name, url in environment.items() if url} | dict(given)).items():
        known = by_name[one_of("a source", name, by_name)]
        _check_url(known, url)
        by_name[name] = replace(known, url=url, is_given=True)
    return by_name


def _check_url(source: Source, url: str) -> None:
    """Raise InputError unless a template can stand in for a source's own."""
    try:
        parts = urlsplit(url)
        used = {field for _, field, _, _ in string.Formatter().parse(url) if field is not None}
    except ValueError as error:
        remedy = "mend it, and double an odd brace"
        raise InputError(f"the URL {url!r} of source {source.name!r} cannot be used ({error}): {remedy}") from error
    if unknown := sorted(used - set(source.placeholders)):
        known = ", ".join(f"{{{field}}}" for field in source.placeholders) or "none"
        raise InputError(f"the URL of source {source.name!r} has the placeholder {{{unknown[0]}}}: there are {known}")
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise InputError(f"the URL {url!r} of source {source.name!r} must begin with https:// or http:// and a host")


def overpass_query(box: Bounds) -> str:
    """Return the quoted Overpass query for every building and part in a box, with all their nodes."""
    west, south, east, north = (f"{value:.6f}" for value in box)
    selectors = "".join(f'{kind}["{tag}"];' for kind in ("way", "relation") for tag in ("building", "building:part"))
    return quote(f"[out:xml][timeout:180][bbox:{south},{west},{north},{east}];({selectors});(._;>;);out body;", safe="")
