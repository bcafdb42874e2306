"""OpenStreetMap files that pyosmium cannot read as they are, as plain ones.

These are packed files, JSON of the Overpass API, XML and JSON of its ``out geom``, where places stand in ways and
members, XML with ways after relations, and that of an editor, whose new objects have ids below 0 and whose deleted ones
are marked.
"""

import json
import mmap
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import count, zip_longest
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import osmium
from osmium.osm.mutable import Node, Relation, Way

from jaxurban.errors import InputError, readable
from jaxurban.io.files import pieces_of
from jaxurban.io.sniff import in_own_words, scratch_folder, sniff, unpacked

Element = dict[str, Any]  # as in the Overpass API's JSON
OBJECTS = ("node", "way", "relation")  # in the order of a file
EDITED = re.compile(rb"""\sid=["']-|action=["']delete""")
PLACED = re.compile(rb"<nd [^/]*\blat=")  # a place in a way or a member
REMARK = re.compile(rb"<remark>\s*(.*?)\s*</remark>", re.DOTALL)
OWN_IDS = 2**40  # the first id of what has none above 0; OpenStreetMap's are far below
MOST_JSON = 2**30  # bytes; JSON is held in memory as a whole, in ten times as many


@contextmanager
def plain_osm(path: str | Path, remedy: str) -> Iterator[Path]:
    """Yield a file of the same content that pyosmium reads: the file itself, or a temporary one.

    XML is written again only if a search in its bytes finds what needs it.

    Args:
      path: of the file.
      remedy: ends the message of a damaged file.

    Raises:
      InputError: a file that is damaged, also by what pyosmium raises in the block, JSON of more than `MOST_JSON`, what
        the Overpass API cut short, or ways or relations without one place.
    """
    name = repr(str(path))
    with (
        readable(path, "OpenStreetMap data", remedy),
        in_own_words(osmium.InvalidLocationError),
        unpacked(path) as file,
        scratch_folder() as folder,
    ):
        kind = sniff(file)
        with in_own_words():
            plain = _as_plain(name, file, kind, folder / "plain.osm")
        yield plain


def _as_plain(name: str, file: Path, kind: str, plain: Path) -> Path:
    """Return a file, or where pyosmium cannot read it ``plain``, which is written then.

    Args:
      name: of the file, for messages.
      file: unpacked.
      kind: its format, by `sniff`.
      plain: where to write.

    Raises:
      InputError: as of `plain_osm`.
    """
    if kind == ".osm.json":
        _write(name, plain, _of_json(name, file), osmium.io.Header())
        return plain
    if kind == ".osm" and _needs_writing(name, file):
        source = osmium.io.File(str(file), "osm")
        with osmium.io.Reader(source, osmium.osm.NOTHING) as reader:
            _write(name, plain, _of_xml(file), reader.header())
        return plain
    return file


def _check_is_whole(name: str, remark: str | None) -> None:
    """Raise InputError if a file has a remark: the Overpass API sends what it had when its time or memory ran out."""
    if remark:
        raise InputError(
            f"{name} is cut short, its server says {remark!r}: ask for a smaller region, or later"
        )


def _needs_writing(name: str, file: Path) -> bool:
    """Return whether XML holds no node, ways after relations, ids below 0, deleted objects, or places in ways.

    Raises:
      InputError: the Overpass API cut it short; ``name`` is for the message.
    """
    with (
        file.open("rb") as source,
        mmap.mmap(source.fileno(), 0, access=mmap.ACCESS_READ) as text,
    ):
        remark = REMARK.search(text)
        if remark:
            _check_is_whole(name, remark[1].decode())
        return (
            text.find(b"<node") < 0
            or text.rfind(b"<way") > text.find(b"<relation") >= 0
            or EDITED.search(text) is not None
            or PLACED.search(text) is not None
        )


def _of_json(name: str, file: Path) -> list[Element]:
    """Return the objects of JSON of the Overpass API.

    Raises:
      InputError: more than `MOST_JSON`, or cut short; ``name`` is for the message.
    """
    if file.stat().st_size > MOST_JSON:
        raise InputError(
            f"{name} is JSON of more than {MOST_JSON / 2**30:g} GiB: ask for XML (`[out:xml]`)"
        )
    content = json.loads(file.read_bytes())
    _check_is_whole(name, content.get("remark"))
    return content["elements"]


def _of_xml(file: Path) -> Iterator[Element]:
    """Yield the objects of XML as the Overpass API's JSON has them, all numbers as text; deleted ones are left out."""
    pieces = pieces_of(file)
    source: Any = SimpleNamespace(read=lambda _: next(pieces, b""))
    for _, item in ElementTree.iterparse(source):
        if item.tag not in OBJECTS:
            continue
        if item.get("action") != "delete":
            yield {
                **_line_of(item),
                "tags": {tag.get("k"): tag.get("v") for tag in item.iterfind("tag")},
                "members": list(map(_line_of, item.iterfind("member"))),
            }
        item.clear()


def _line_of(item: ElementTree.Element) -> Element:
    """Return the attributes of an object or a member, its type, its nodes, and the places that it has of them."""
    corners = item.findall("nd")
    return {
        "type": item.tag,
        **item.attrib,
        "nodes": [corner.get("ref") for corner in corners],
        "geometry": [corner.attrib for corner in corners],
    }


class _PlainObjects:
    """Objects, as the Overpass API's JSON has them, as those of pyosmium.

    Nodes and ways that the file has in ways and members alone become nodes and ways too. Of an object that comes
    several times (with its tags, and again as what another one refers to) the last one with tags counts.

    Attributes:
      by_kind: the objects by kind, as in `OBJECTS`, and by id.
    """

    def __init__(self) -> None:
        """Begin without an object."""
        self.by_kind: dict[str, dict[int, Any]] = {kind: {} for kind in OBJECTS}
        self._own_ids: defaultdict[tuple[str, str], int] = defaultdict(count(OWN_IDS).__next__)

    def id_of(self, kind: str, ref: Any) -> int:
        """Return an object's id, above 0: the file's, or for another text one from `OWN_IDS` on."""
        text = str(ref)
        return int(text) if text.isdigit() else self._own_ids[kind, text]

    def add(self, kind: str, ref: Any, about: Element) -> None:
        """Add an object with all that it holds, unless there is one that says more."""
        item: Any
        if kind == "node":
            item = Node(location=(float(about["lon"]), float(about["lat"])))
        elif kind == "way":
            item = Way(nodes=self._node_ids(about))
        else:
            item = Relation(members=self._members(about))
        item.id = self.id_of(kind, ref)
        item.tags = about.get("tags")
        by_id = self.by_kind[kind]
        if item.tags or item.id not in by_id:
            by_id[item.id] = item

    def _node_ids(self, way: Element) -> list[int]:
        """Return the ids of a way's nodes, of which those with a place are added."""
        ids = []
        for node, place in zip_longest(way.get("nodes", ()), way.get("geometry", ())):
            ref = node or str(place)  # a node without an id is known by its place
            if place and "lat" in place:
                self.add("node", ref, place)
            ids.append(self.id_of("node", ref))
        return ids

    def _members(self, relation: Element) -> list[tuple[str, int, str]]:
        """Return the members of a relation, letter of their kind, id and role; those with places are added."""
        members = []
        for member in relation.get("members", ()):
            kind, ref = member["type"], member["ref"]
            if member.get("geometry"):
                self.add(kind, ref, member)
            members.append((kind[0], self.id_of(kind, ref), member["role"]))
        return members


def _write(name: str, plain: Path, elements: Iterable[Element], header: osmium.io.Header) -> None:
    """Write objects, as the Overpass API's JSON has them, as plain XML in order (see `_PlainObjects`).

    Args:
      name: of their file, for messages.
      plain: the file to write.
      elements: the objects.
      header: of the file to write.

    Raises:
      InputError: ways or relations without one node.
    """
    objects = _PlainObjects()
    for element in elements:
        if element["type"] in OBJECTS:
            objects.add(element["type"], element["id"], element)
    nodes, ways, relations = objects.by_kind.values()
    if (ways or relations) and not nodes:
        raise InputError(
            f"{name} holds ways or relations and not one node, so that their places are not known: end the query in "
            "`(._;>;); out;`, or in `out geom;`"
        )
    with osmium.SimpleWriter(str(plain), header=header) as writer:
        for by_id in (nodes, ways, relations):
            for ref in sorted(by_id):
                writer.add(by_id[ref])
