#!/bin/bash
# v2xflexstack 0.11.2 (ETSI's C-ITS stack in Python), GeoBroadcast: the angle of an area is read and not used.
#
# A rectangle or an ellipse of GeoNetworking has half lengths a and b and an azimuth, the angle of its long side from
# North (EN 302 931; EN 302 636-4-1, GBC header). Whether a station lies within decides what its router hands upwards,
# passes on or drops. Router.gn_geometric_function_f takes the difference to the north for the long side whatever
# area.angle says: a warning along a road to the east reaches those who stand up to a metres north and south of its
# middle and not those on the road. The header carries the angle there and back, so that a test of the bytes finds
# nothing. (transform_distance_angle, which nobody calls, is no rotation either.) Where a and b are equal nothing shows.
#
# Way out: areas with equal a and b, or turn the difference yourself: with e, n metres to the east and north and the
# azimuth t, e sin t + n cos t along a and e cos t - n sin t along b.
#
# Seen (2026-11-30), 200 m x 10 m (half lengths), a car 150 m off; F of the rectangle and of the ellipse, inside: F >= 0
#     angle 0, car to the north: 0.4, 0.4; to the east: -224.0, -224.0
#     angle 90, car to the north: 0.4, 0.4; to the east: -224.0, -224.0
#     by hand for 90: to the north -224.0, -224.0; to the east 0.4, 0.4
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet v2xflexstack==0.11.2 asn1tools==0.165.0 ecdsa==0.18.0 tinydb==4.7.1 \
    python-dateutil==2.8.2
"$folder/venv/bin/python" - <<'PYTHON'
import math
import sys

from flexstack.geonet.mib import MIB
from flexstack.geonet.router import Router
from flexstack.geonet.service_access_point import Area, GeoBroadcastHST

EARTH_M, LATITUDE, LONGITUDE = 6_371_000, 48.78, 9.18
SHAPES = (GeoBroadcastHST.GEOBROADCAST_RECT, GeoBroadcastHST.GEOBROADCAST_ELIP)


def units(east, north):
    """Latitude and longitude in ETSI's units, 0.1 microdegrees, of a place so many metres off."""
    latitude = LATITUDE + math.degrees(north / EARTH_M)
    longitude = LONGITUDE + math.degrees(east / EARTH_M / math.cos(math.radians(LATITUDE)))
    return round(1e7 * latitude), round(1e7 * longitude)


router = Router(MIB())
latitude, longitude = units(0, 0)
found = {}
for angle in (0, 90):
    area = Area(latitude=latitude, longitude=longitude, a=200, b=10, angle=angle)
    for name, place in (("north", (0, 150)), ("east", (150, 0))):
        found[angle, name] = [round(router.gn_geometric_function_f(shape, area, *units(*place)), 1) for shape in SHAPES]
    north, east = (", ".join(f"{value}" for value in found[angle, name]) for name in ("north", "east"))
    print(f"angle {angle}, car to the north: {north}; to the east: {east}")
as_seen = all(found[angle, "north"] == [0.4, 0.4] and found[angle, "east"] == [-224.0, -224.0] for angle in (0, 90))
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
