#!/bin/bash
# carla 0.9.16 (Python package, no server), Map.transform_to_geolocation: north is south, and metres are no WGS84 metres.
#
# OpenDRIVE's inertial frame has y to the north; CARLA, left-handed, gives the same place the opposite y. A road that
# leaves the origin due north has waypoints at y = -499, -998. transform_to_geolocation puts these SOUTH of the map's
# origin: the latitude falls by what it should rise. What comes out of a V2X message is a mirror image of the map.
# Of <geoReference> only lat_0 and lon_0 are taken. The ellipsoid, k, x_0 and y_0 are not: an offset of x_0=500,
# y_0=200 changes nothing and nothing is said. A kilometre east at latitude 48.78 is 1,002.3 m of WGS84 away (one north
# 999.4 m), so a place 100 m east is 0.23 m from where PROJ puts it with the same geoReference. A reference that has no
# lat_0 and lon_0 (UTM), or none, makes latitude 42, longitude 2, with a line of warning. geolocation_to_transform is
# the inverse of all this, so that a test of both, one after the other, finds nothing.
# CARLA's manual says that the map's place comes from the geoReference and is silent on the rest; newer versions than
# this one document projections and an ellipsoid. What the server's GNSS sensor says was not tried.
#
# Way out: carry places as x, y, z; or take east = x, north = -y and hand them to PROJ with the map's geoReference.
#
# Seen (2026-11-29), origin 48.78 N, 9.18 E:
#     998 m up a road to the north: waypoint (1, -998), 48.771031 N, PROJ of OpenDRIVE's (1, 998) 48.788974 N
#     1000 m east: 1002.30 m away on WGS84, by PROJ 1000.00 m; with x_0=500 y_0=200 the same place True
#     UTM: 42.0 N, 2.0 E; there and back (1, -998)
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet carla==0.9.16 pyproj==3.7.2
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import carla
from pyproj import Geod, Transformer

NORTHWARDS = """<?xml version="1.0"?>
<OpenDRIVE><header revMajor="1" revMinor="4"><geoReference><![CDATA[{}]]></geoReference></header>
<road name="to the north" length="1000" id="1" junction="-1"><link/>
<planView><geometry s="0" x="0" y="0" hdg="1.5707963267948966" length="1000"><line/></geometry></planView>
<elevationProfile/><lateralProfile/><lanes><laneSection s="0">
<center><lane id="0" type="none" level="false"/></center>
<right><lane id="-1" type="driving" level="false"><width sOffset="0" a="2" b="0" c="0" d="0"/></lane></right>
</laneSection></lanes></road></OpenDRIVE>"""
TMERC = "+proj=tmerc +lat_0=48.78 +lon_0=9.18 +k=1 +x_0={} +y_0={} +datum=WGS84 +units=m +no_defs"
UTM = "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs"
here = carla.Map("here", NORTHWARDS.format(TMERC.format(0, 0)))
shifted = carla.Map("shifted", NORTHWARDS.format(TMERC.format(500, 200)))
utm = carla.Map("utm", NORTHWARDS.format(UTM))
proj, ellipsoid = Transformer.from_crs(TMERC.format(0, 0), "EPSG:4326", always_xy=True), Geod(ellps="WGS84")


def place(world, x, y):
    found = world.transform_to_geolocation(carla.Location(float(x), float(y), 0.0))
    return found.longitude, found.latitude


origin = place(here, 0, 0)
far = max((w.transform.location for w in here.generate_waypoints(499.0)), key=lambda location: abs(location.y))
by_carla = here.transform_to_geolocation(far)
latitude = proj.transform(1.0, 998.0)[1]
print(f"998 m up a road to the north: waypoint ({far.x:.0f}, {far.y:.0f}), {by_carla.latitude:.6f} N, ", end="")
print(f"PROJ of OpenDRIVE's (1, 998) {latitude:.6f} N")
east, true_east = place(here, 1000, 0), proj.transform(1000.0, 0.0)
metres, true_metres = (ellipsoid.inv(*origin, *end)[2] for end in (east, true_east))
same = place(shifted, 1000, 0) == east
print(f"1000 m east: {metres:.2f} m away on WGS84, by PROJ {true_metres:.2f} m; with x_0=500 y_0=200 the same place {same}")
longitude_of_utm, latitude_of_utm = place(utm, 0, 0)
back = here.geolocation_to_transform(by_carla)
print(f"UTM: {latitude_of_utm} N, {longitude_of_utm} E; there and back ({back.x:.0f}, {back.y:.0f})")
as_seen = far.y < -990 and by_carla.latitude < 48.7711 < 48.7889 < latitude
as_seen &= abs(metres - 1002.30) < 0.05 and abs(true_metres - 1000) < 0.05 and same
as_seen &= (latitude_of_utm, longitude_of_utm) == (42, 2) and abs(back.y - far.y) < 0.01
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
