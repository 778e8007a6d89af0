#!/bin/bash
# scenariogeneration 0.16.7, xodr.Object: an object's id is changed because another file of the same process has it.
#
# OpenDRIVE asks that an object's id be unique "within database", which is one file. The library keeps the used ids in a
# list of the class that nothing ever empties: the second map that a program writes gets other ids than it asked for. Two
# runs over the same maps in another order give other files, and whatever refers to an object by its id (an
# objectReference, a table of our own) points at nothing. It prints a line and goes on.
#
# Seen (2026-11-29), the id "slot_1" asked for in two maps of one object each:
#     Warning: id slot_1 has already been used for another Object ...auto-generating unique id.
#     first map slot_1, second map 0
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scenariogeneration==0.16.7 numpy==2.2.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys

from scenariogeneration import xodr


def ids():
    """Of the objects of a fresh map with one road of 20 m and one object, asked for as slot_1."""
    road = xodr.create_road(xodr.Line(20), 1)
    road.add_object(xodr.Object(5, -6, xodr.ObjectType.parkingSpace, id="slot_1", length=5.0, width=2.5))
    world = xodr.OpenDrive("map")
    world.add_road(road)
    world.adjust_roads_and_lanes()
    return [element.get("id") for element in world.get_element().iter("object")]


(first,), (second,) = ids(), ids()
print(f"first map {first}, second map {second}")
as_seen = first == "slot_1" and second != "slot_1"
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
