#!/bin/bash
# commonroad-scenario-designer 0.8.5, OpenDRIVE to CommonRoad: a map that says where on Earth it lies grows by half in Germany,
# and Chicago comes out in China.
#
# A <geoReference> in an OpenDRIVE file names the projection of its metres; "+proj=tmerc +lat_0=48.78 +lon_0=9.18" is usual.
# The converter transforms such a map, and no other, to EPSG:3857, the picture tiles' "pseudo mercator", unless told otherwise.
# Its unit is called a metre, too, but is one at the equator alone; at latitude 48.78 an aisle 50 m x 3 m is 75.7 m x 4.56 m. Cars
# and speeds stay in metres: where no car fits between two, one does. The scenario's scaling is given as 1. A map without a
# geoReference is marked EPSG:3857, too, but is left as it is, so that a test with one finds nothing. The scenario's latitude
# and longitude come from a search for digits: -87.6 becomes 87.6. The option is called proj_string_odr, "String used for the
# initialization of projection".
#
# Way out: open_drive_config.proj_string_odr = None before the conversion, as the maintainers say for something else in
# issue 22 of CommonRoad/commonroad-scenario-designer; signs of lat_0 and lon_0 by hand.
#
# Seen (2026-12-01), a road 50 m long with a lane 3 m wide: length, width, scaling, latitude and longitude in the scenario
# (999: not known)
#     no geoReference: 50.0 3.00 1 999 999
#     Stuttgart: 75.7 4.56 1 48.78 9.18
#     Chicago: 67.1 4.04 1 41.88 87.63
#     Stuttgart, proj_string_odr None: 50.0 3.00 None 999 999
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# What the conversion imports; the package's own list has SUMO, metis and Qt on top.
"$folder/venv/bin/pip" install --quiet --no-deps commonroad-scenario-designer==0.8.5 commonroad-io==2024.3 \
    commonroad-clcs==2025.2.0 certifi==2026.10.19.post1 charset-normalizer==3.5.3 idna==3.20 iso3166==2.1.1 lxml==6.1.3 \
    mgrs==1.6.0 numpy==2.4.6 omegaconf==2.4.0 protobuf==3.20.2 pyclothoids==0.2.0 pyproj==3.7.2 PyYAML==6.0.4 \
    requests==2.34.2 scipy==1.17.1 setuptools==80.9.0 shapely==2.2.0 urllib3==2.8.0
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

sys.modules["PyQt6"] = ModuleType("PyQt6")
core = sys.modules["PyQt6.QtCore"] = ModuleType("PyQt6.QtCore")  # for the settings dialog
core.QObject, core.pyqtSignal = object, lambda: None

from crdesigner.common.config.general_config import general_config
from crdesigner.common.config.opendrive_config import open_drive_config
from crdesigner.map_conversion.opendrive.odr2cr.opendrive_conversion.network import Network
from crdesigner.map_conversion.opendrive.odr2cr.opendrive_parser.parser import parse_opendrive

MAP = """<OpenDRIVE><header revMajor="1" revMinor="7">{}</header>
  <road id="1" junction="-1" length="50" rule="RHT">
    <planView><geometry s="0" x="0" y="0" hdg="0" length="50"><line/></geometry></planView>
    <lanes><laneSection s="0">
      <center><lane id="0" type="none"/></center>
      <right><lane id="-1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane></right>
    </laneSection></lanes>
  </road></OpenDRIVE>"""
STUTTGART, CHICAGO = (
    f"<geoReference><![CDATA[+proj=tmerc +lat_0={place} +datum=WGS84]]></geoReference>"
    for place in ("48.78 +lon_0=9.18", "41.88 +lon_0=-87.63")
)


def converted(reference):
    Path("aisle.xodr").write_text(MAP.format(reference))
    network = Network()
    network.load_opendrive(parse_opendrive(Path("aisle.xodr")))
    scenario = network.export_commonroad_scenario(general_config, open_drive_config)
    (lane,) = scenario.lanelet_network.lanelets
    length = np.linalg.norm(lane.left_vertices[-1] - lane.left_vertices[0])
    width = np.linalg.norm(lane.left_vertices[0] - lane.right_vertices[0])
    place = scenario.location
    scaling = place.geo_transformation.scaling if place.geo_transformation else None
    return f"{length:.1f} {width:.2f} {scaling} {place.gps_latitude} {place.gps_longitude}"


found = {"no geoReference": converted(""), "Stuttgart": converted(STUTTGART), "Chicago": converted(CHICAGO)}
open_drive_config.proj_string_odr = None
found["Stuttgart, proj_string_odr None"] = converted(STUTTGART)
print("\n".join(f"{name}: {values}" for name, values in found.items()))
as_seen = list(found.values()) == [
    "50.0 3.00 1 999 999",
    "75.7 4.56 1 48.78 9.18",
    "67.1 4.04 1 41.88 87.63",
    "50.0 3.00 None 999 999",
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
