"""The public sources that `jaxurban fetch` knows: where they are, whose they are, and how they want to be asked."""

import os
import string
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from urllib.parse import quote, urlsplit

from jaxurban.errors import InputError, nearest_name
from jaxurban.grid import Bounds

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
      num_tries: how often a busy server is asked.
    """

    name: str
    url: str
    placeholders: tuple[str, ...]
    credit: str
    licence: str
    fresh_s: float
    num_tries: int = 4


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


def known_sources(census_year: str = "2020") -> dict[str, Source]:
    """Return the sources by name, those of the census for its year.

    The Census Data API asks for a personal key; TIGERweb, which holds the same counts by block, does not. CelesTrak
    updates every two hours and wants programs to stop at the first refusal; two-line elements cannot name satellites
    catalogued since 2026, so its OMM (CSV) is asked for.
    """
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
        Source("checksum", "{url}.md5", ("url",), "Geofabrik GmbH", "as the extract", 0.0),
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
    return {source.name: source for source in sources}


def chosen_urls(sources: Mapping[str, Source], given: Mapping[str, str]) -> dict[str, str]:
    """Return the URL templates that replace the known ones: those ``given``, else those of the environment.

    Raises:
      InputError: a name that is no source, no http(s) URL, or an unknown placeholder.
    """
    environment = {name: os.environ.get(ENVIRONMENT_PREFIX + name.upper(), "") for name in sources}
    urls = {name: url for name, url in environment.items() if url} | dict(given)
    for name, url in urls.items():
        if name not in sources:
            hint = nearest_name(name, sources) or f"; there are {', '.join(sources)}"
            raise InputError(f"{name!r} is no source{hint}")
        placeholders = sources[name].placeholders
        try:
            used = {field for _, field, _, _ in string.Formatter().parse(url) if field is not None}
        except ValueError as error:
            raise InputError(f"the URL {url!r} of source {name!r} has an odd brace ({error}): double it") from error
        if unknown := sorted(used - set(placeholders)):
            known = ", ".join(f"{{{field}}}" for field in placeholders) or "none"
            raise InputError(f"the URL of source {name!r} has the placeholder {{{unknown[0]}}}: there are {known}")
        parts = urlsplit(url)
        if name != "checksum" and (parts.scheme not in ("http", "https") or not parts.hostname):
            raise InputError(f"the URL {url!r} of source {name!r} must begin with https:// or http:// and a host")
    return urls


def fill(template: str, box: Bounds | None = None, **values: str) -> str:
    """Return a template's URL; ``box`` is west, south, east, north in degrees."""
    if box is not None:
        values |= {name: f"{value:.6f}" for name, value in zip(BOX, box, strict=True)}
    return template.format(**values)


def overpass_query(box: Bounds) -> str:
    """Return the quoted Overpass query for every building and part in a box, with all their nodes."""
    west, south, east, north = (f"{value:.6f}" for value in box)
    kinds = "".join(f'{kind}["{tag}"];' for kind in ("way", "relation") for tag in ("building", "building:part"))
    return quote(f"[out:xml][timeout:180][bbox:{south},{west},{north},{east}];({kinds});(._;>;);out body;", safe="")
