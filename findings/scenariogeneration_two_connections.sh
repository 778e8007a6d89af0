#!/bin/bash
# scenariogeneration 0.16.7, xodr.CommonJunctionCreator: a junction of its default connections breaks a rule of
# OpenDRIVE 1.7, the revision that the file names; ASAM's checker (asam-qc-opendrive 1.0.0) finds it and exits with 0.
#
# asam.net:xodr:1.7.0:junctions.connection.one_connection_element: "Each connecting road shall be represented by only
# one <connection> element. A <connection> element may contain more than one <laneLink>." add_connection(a, b) without
# lanes makes one connecting road with a lane for each direction and writes two <connection> elements for it, one from
# either side. With lanes named, add_connection(a, b, -1, -1) and add_connection(b, a, 1, 1), each way has a road of its
# own and the rule holds. The checker's exit status is 0 with issues of level 1 (error) as without: read the result file.
#
# Seen (2026-11-29), two straight roads that meet head on in a junction:
#     default: exit status 0, rule completed 1, one_connection_element 1
#     lanes: exit status 0, rule completed 1, one_connection_element 0
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/writer"
"$folder/writer/bin/pip" install --quiet scenariogeneration==0.16.7 numpy==2.2.6
python3 -m venv "$folder/checker"
"$folder/checker/bin/pip" install --quiet asam-qc-opendrive==1.0.0 asam-qc-baselib==1.1.0 numpy==1.26.4
cd "$folder"
writer/bin/python - <<'PYTHON'
from math import pi

from scenariogeneration import xodr


def road(number, x):
    view = xodr.PlanView(x, 0, 0)
    view.add_geometry(xodr.Line(20))
    section = xodr.LaneSection(0, xodr.Lane())
    section.add_left_lane(xodr.Lane(a=3.0))
    section.add_right_lane(xodr.Lane(a=3.0))
    lanes = xodr.Lanes()
    lanes.add_lanesection(section)
    return xodr.Road(number, view, lanes)


for name, connections in (("default", [(1, 2)]), ("lanes", [(1, 2, -1, -1), (2, 1, 1, 1)])):
    before, behind = road(1, 0), road(2, 30)
    junction = xodr.CommonJunctionCreator(100, "junction", startnum=101)
    junction.add_incoming_road_cartesian_geometry(before, -5, 0, 0, "successor")
    junction.add_incoming_road_cartesian_geometry(behind, 5, 0, pi, "predecessor")
    for connection in connections:
        junction.add_connection(*connection)
    world = xodr.OpenDrive(name, revMinor="7")
    world.add_road(before)
    world.add_road(behind)
    world.add_junction_creator(junction)
    world.adjust_roads_and_lanes()
    world.write_xml(f"{name}.xodr")
PYTHON
issues() {
    cat > config.xml <<XML
<Config><Param name="InputFile" value="$folder/$1.xodr"/>
<CheckerBundle application="xodrBundle"><Param name="resultFile" value="$1.xqar"/></CheckerBundle></Config>
XML
    status=0
    checker/bin/qc_opendrive -c config.xml > log 2>&1 || status=$?
    found=$(grep -c '<Issue .*one_connection_element' "$1.xqar" || true)
    completed=$(grep -c 'one_connection_element.*status="completed"\|status="completed".*one_connection_element' "$1.xqar" || true)
    echo "$1: exit status $status, rule completed $completed, one_connection_element $found" | tee -a seen
}
issues default
issues lanes
if grep -q '^default: exit status 0, rule completed 1, one_connection_element 1$' seen &&
    grep -q '^lanes: exit status 0, rule completed 1, one_connection_element 0$' seen; then
    echo "as seen"
else
    echo "changed"
    exit 1
fi
