#!/bin/bash
# v2xflexstack 0.11.2 (ETSI's C-ITS stack in Python), from a fix of gpsd to the air: the ellipse of confidence points to
# the north whichever way it lies, and the position vector's time is cut to whole seconds.
#
# gpsd gives the 95 % error to the east as epx and to the north as epy. A CAM carries an ellipse: half axes in cm and the
# azimuth of the longer one, 0 for North, 900 for East (TS 102 894-2, PositionConfidenceEllipse). create_position_confidence
# puts the greater of both first, as it must, and writes 0 beside it either way: 3 m to the east, as on a street to the
# north between houses, become 3 m to the north, and a receiver that weighs positions by their ellipses trusts the wrong
# axis. The message is a valid one. The function that fills a VAM does the same.
# LongPositionVector.refresh_with_tpv_data cuts the fix's time to seconds before it makes milliseconds of it (TST): at
# 10 Hz ten places in a row have one time. At 13 m/s that is up to 12 m, and EN 302 636-4-1 compares TSTs to know which
# of two positions is the newer. The CAM's own generationDeltaTime has the milliseconds.
#
# Way out: set semiMajorAxisOrientation to 900 where epx > epy; set_tst_in_normal_timestamp_milliseconds afterwards.
#
# Seen (2026-11-30), epx, epy (m): half axes (cm), azimuth of the longer (0.1 degree); then the times of ten fixes in 1 s
#     3.0, 0.5: 300, 50, 0
#     0.5, 3.0: 300, 50, 0
#     fixes 0 to 900 ms after the full second: TST 0 ms, all ten; generationDeltaTime 0 to 900 ms
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet v2xflexstack==0.11.2 asn1tools==0.165.0 ecdsa==0.18.0 tinydb==4.7.1 \
    python-dateutil==2.8.2
"$folder/venv/bin/python" - <<'PYTHON'
import sys

from flexstack.facilities.ca_basic_service.cam_coder import CAMCoder
from flexstack.facilities.ca_basic_service.cam_transmission_management import CooperativeAwarenessMessage
from flexstack.geonet.position_vector import LongPositionVector

coder = CAMCoder()


def fix(east=1.0, north=1.0, milliseconds=0):
    """What gpsd reports of a car that drives east at 13 m/s."""
    place = {"lat": 48.78, "lon": 9.18, "altHAE": 300.0, "speed": 13.0, "track": 90.0}
    errors = {"epx": east, "epy": north, "epv": 1.5, "epd": 1.0}
    return {"class": "TPV", "time": f"2026-11-30T12:00:00.{milliseconds:03d}Z"} | place | errors


def sent(report):
    """The CAM of a fix, as a receiver decodes it."""
    message = CooperativeAwarenessMessage()
    message.fullfill_with_tpv_data(report)
    return coder.decode(coder.encode(message.cam))["cam"]


axes = {}
for east, north in ((3.0, 0.5), (0.5, 3.0)):
    received = sent(fix(east, north))["camParameters"]["basicContainer"]["referencePosition"]
    axes[east, north] = tuple(received["positionConfidenceEllipse"].values())
    print(f"{east}, {north}: {', '.join(str(value) for value in axes[east, north])}")
reports = [fix(milliseconds=100 * k) for k in range(10)]
vectors = [LongPositionVector().refresh_with_tpv_data(report).tst.msec for report in reports]
deltas = [sent(report)["generationDeltaTime"] for report in reports]
vectors = [time - vectors[0] for time in vectors]
deltas = [time - deltas[0] for time in deltas]
print(f"fixes 0 to 900 ms after the full second: TST {vectors}; generationDeltaTime {deltas}")
as_seen = axes == {(3.0, 0.5): (300, 50, 0), (0.5, 3.0): (300, 50, 0)}
as_seen &= vectors == [0] * 10 and deltas == list(range(0, 1000, 100))
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
