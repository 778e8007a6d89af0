#!/bin/bash
# lanelet2 1.2.3: what the origin of a map is the origin of depends on the projector.
#
# A projector is made of Origin(lat, lon, alt), and by a maintainer's word "all projectors in Lanelet2 work in local
# coordinates where the original origin has the coordinates (0,0)" (issue 181). UtmProjector moves x and y there and leaves
# z at the height above the ellipsoid; MercatorProjector moves nothing, its origin gives the scale alone, and the garage
# lies 4,000 km to the north; LocalCartesianProjector moves all three. One map, one origin, another projector: the floor is
# at 250 m instead of 0, above every filter by height, or a map without "ele" (read as 0 m) lies 250 m under the cars.
# lanelet2.io.write with the projector that read the map takes it back, so that there and back finds nothing; with
# another one, LocalCartesian in and UTM out, the file's heights are wrong by the origin's altitude.
#
# Way out: LocalCartesianProjector; or Origin(lat, lon) without altitude and heights of your own.
#
# Seen (2026-11-30), origin 48.78 N, 9.18 E, 250 m; x, y, z (m) of the origin, of a node without "ele" at the same place;
# "ele" of the origin after LocalCartesian in and this projector out
#     UtmProjector: 0 0 250, 0 0 0; 0
#     MercatorProjector: 673392 4110289 250, 673392 4110289 0; 0
#     LocalCartesianProjector: 0 0 0, 0 0 -250; 250
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet lanelet2==1.2.3
cd "$folder"
venv/bin/python - <<'PYTHON'
import re
import sys
from pathlib import Path

import lanelet2
from lanelet2.core import getId

NODE = '<node id="{}" version="1" visible="true" lat="48.78" lon="9.18">{}</node>'
ELE = '<tag k="ele" v="250"/>'
Path("garage.osm").write_text(
    f'<?xml version="1.0"?><osm version="0.6">{NODE.format(1, ELE)}{NODE.format(2, "")}'
    '<way id="3" version="1" visible="true"><nd ref="1"/><nd ref="2"/></way></osm>'
)
ORIGIN = lanelet2.io.Origin(48.78, 9.18, 250.0)
lanelet2.io.load("garage.osm", lanelet2.projection.LocalCartesianProjector(ORIGIN))
found = {}
for name in ("UtmProjector", "MercatorProjector", "LocalCartesianProjector"):
    projector = getattr(lanelet2.projection, name)(ORIGIN)
    points = {point.id: point for point in lanelet2.io.load("garage.osm", projector).pointLayer}
    places = ", ".join(f"{round(p.x)} {round(p.y)} {round(p.z)}" for p in (points[1], points[2]))
    here = lanelet2.core.Point3d(getId(), 0.0, 0.0, 0.0)
    made = lanelet2.core.LaneletMap()
    made.add(here)
    lanelet2.io.write("out.osm", made, projector)
    ele = re.search(r'k="ele" v="([^"]*)"', Path("out.osm").read_text())
    found[name] = f"{places}; {round(float(ele[1])) if ele else 0}"
    print(f"{name}: {found[name]}")
as_seen = list(found.values()) == [
    "0 0 250, 0 0 0; 0",
    "673392 4110289 250, 673392 4110289 0; 0",
    "0 0 0, 0 0 -250; 250",
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
