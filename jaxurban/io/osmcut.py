"""The buildings of a box, cut out of an OpenStreetMap extract, so that a whole country's need not be assembled."""

from collections.abc import Iterator
from pathlib import Path

import osmium
from osmium.filter import IdFilter, KeyFilter

from jaxurban.grid import Bounds

HAS_BUILDING = KeyFilter("building", "building:part")


def cut_buildings(source: Path, target: Path, box: Bounds) -> None:
    """Write the ways and relations tagged as buildings that have a node in a box, with all that they refer to.

    Args:
      source: a PBF file, nodes before ways before relations.
      target: the PBF file to write; an old one is replaced.
      box: west, south, east, north in degrees.
    """
    file = osmium.io.File(str(source), "pbf")
    # The member ways of a building relation need not bear the tag themselves.
    ways_of = {
        relation.id: {member.ref for member in relation.members if member.type == "w"} for relation in _relations(file)
    }
    members = set().union(*ways_of.values())
    near = {way.id for way in _ways_in(file, IdFilter(members), box)} if members else set()
    result = osmium.io.File(str(target), "pbf")
    with osmium.BackReferenceWriter(result, ref_src=file, overwrite=True, remove_tags=False) as writer:
        for way in _ways_in(file, HAS_BUILDING, box):
            writer.add(way)
        for relation in _relations(file):
            if not near.isdisjoint(ways_of[relation.id]):
                writer.add(relation)


def _relations(file: osmium.io.File) -> Iterator[osmium.osm.Relation]:
    for item in osmium.FileProcessor(file, osmium.osm.RELATION).with_filter(HAS_BUILDING):
        if isinstance(item, osmium.osm.Relation):
            yield item


def _ways_in(file: osmium.io.File, chosen: IdFilter | KeyFilter, box: Bounds) -> Iterator[osmium.osm.Way]:
    """Yield the chosen ways that have a node in a box."""
    west, south, east, north = box
    for item in osmium.FileProcessor(file, osmium.osm.NODE | osmium.osm.WAY).with_locations().with_filter(chosen):
        if isinstance(item, osmium.osm.Way):
            places = (node.location for node in item.nodes if node.location.valid())
            if any(west <= place.lon <= east and south <= place.lat <= north for place in places):
                yield item
