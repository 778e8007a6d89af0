#!/bin/bash
# commonroad-scenario-designer 0.8.5, OpenDRIVE to CommonRoad: a lane's speed limit in m/s, OpenDRIVE's own unit, is dropped,
# and the road's limit takes its place.
#
# "max" of a lane's <speed> is in the unit that "unit" names, m/s if it names none. The converter knows km/h and mph; of
# anything else, m/s and no unit among them, nothing is kept. If the road has a <type> with a limit, 50 km/h in town, its
# lanes without one get it: an aisle at walking pace, 2.8 m/s, comes out with 13.85 m/s, five times as fast, and without a
# <type> with no limit at all. A limit of the <type> itself may be in m/s. (Its 50 km/h are 13.85 m/s besides, by a factor of
# 0.277; a lane's are 13.89.)
#
# Way out: write lanes' limits in km/h, or the roads' in m/s, or set them after the conversion.
#
# Seen (2026-12-01), a lane's limit; speed limit of the lane in m/s on a road without a type, in town (50 km/h)
#     10 km/h: 2.78, 2.78
#     2.8 m/s: none, 13.85
#     2.8: none, 13.85
#     none: none, 13.85
#     none, the town's in m/s (2.8): 2.80
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

sys.modules["PyQt6"] = ModuleType("PyQt6")
core = sys.modules["PyQt6.QtCore"] = ModuleType("PyQt6.QtCore")  # for the settings dialog
core.QObject, core.pyqtSignal = object, lambda: None

from crdesigner.common.config.general_config import general_config
from crdesigner.common.config.opendrive_config import open_drive_config
from crdesigner.map_conversion.opendrive.odr2cr.opendrive_conversion.network import Network
from crdesigner.map_conversion.opendrive.odr2cr.opendrive_parser.parser import parse_opendrive

MAP = """<OpenDRIVE><header revMajor="1" revMinor="7"/>
  <road id="1" junction="-1" length="50" rule="RHT">{type}
    <planView><geometry s="0" x="0" y="0" hdg="0" length="50"><line/></geometry></planView>
    <lanes><laneSection s="0">
      <center><lane id="0" type="none"/></center>
      <right><lane id="-1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/>{speed}</lane></right>
    </laneSection></lanes>
  </road></OpenDRIVE>"""
TOWN = '<type s="0" type="town"><speed max="50" unit="km/h"/></type>'
SPEEDS = {
    "10 km/h": '<speed sOffset="0" max="10" unit="km/h"/>',
    "2.8 m/s": '<speed sOffset="0" max="2.8" unit="m/s"/>',
    "2.8": '<speed sOffset="0" max="2.8"/>',
    "none": "",
}


def limit(speed, road_type):
    Path("aisle.xodr").write_text(MAP.format(speed=speed, type=road_type))
    network = Network()
    network.load_opendrive(parse_opendrive(Path("aisle.xodr")))
    signs = network.export_commonroad_scenario(general_config, open_drive_config).lanelet_network.traffic_signs
    limits = [element.additional_values[0] for sign in signs for element in sign.traffic_sign_elements]
    return " ".join(f"{float(value):.2f}" for value in limits) or "none"


found = {name: f"{limit(speed, '')}, {limit(speed, TOWN)}" for name, speed in SPEEDS.items()}
found["none, the town's in m/s (2.8)"] = limit("", TOWN.replace('max="50" unit="km/h"', 'max="2.8" unit="m/s"'))
print("\n".join(f"{name}: {limits}" for name, limits in found.items()))
as_seen = list(found.values()) == ["2.78, 2.78", "none, 13.85", "none, 13.85", "none, 13.85", "2.80"]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
