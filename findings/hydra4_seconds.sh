#!/bin/bash
# hydra4 0.2.0 (Hesai packets to clouds), Pandar XT-32: within a packet times jump by 50 seconds from block to block.
#
# A packet holds eight blocks of 32 points, 50 microseconds apart, and one time. Of that the decoder takes off 50 a block
# without making seconds of it; the channels' offsets it does divide by a million. "stamp" of the first block lies 350 s too
# early, of the last 3.28 s too late, in every packet. A tenth of a second of turning sensor covers six minutes. x, y, z,
# intensity and ring are right. Whoever straightens a cloud by "stamp", or takes its smallest for the time of the frame,
# lays it six minutes away from the other sensors. The decoder of the Pandar OT128 divides.
# The packet's time is UTC by the sensor's manual; it is read as the computer's local time: in Tokyo nine hours early.
#
# Way out: TZ=UTC, and stamp only to the second; times from the azimuth: a turn's time x azimuth / 36000.
#
# Seen (2026-11-30), a packet of 2026-11-30 12:00:00.5 UTC, by time zone: seconds from there to the first channel of each
# block, rounded to whole ones
#     UTC: -347 -297 -247 -197 -147 -97 -47 3
#     JST-9: -32747 -32697 -32647 -32597 -32547 -32497 -32447 -32397
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet hydra4==0.2.0 pypcd4==1.5.1 numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
import struct
from datetime import datetime, timezone

import numpy as np
from hydra4 import Hydra
from hydra4.msgs import (
    builtin_interfaces__msg__Time,
    pandar_msgs__msg__PandarPacket,
    pandar_msgs__msg__PandarScan,
    std_msgs__msg__Header,
)

MIDDAY = datetime(2026, 11, 30, 12, 0, 0, 500_000, tzinfo=timezone.utc)
NOW = builtin_interfaces__msg__Time(sec=0, nanosec=0)
STRONGEST = 0x37


def packet(azimuth):
    """Eight blocks from ``azimuth`` (hundredths of a degree) on, everything 10 m away, taken at MIDDAY."""
    before = bytes([0xEE, 0xFF, 6, 1, 0, 0, 32, 8, 0, 4, 1, 0])
    blocks = b"".join(struct.pack("<H", azimuth + 18 * b) + struct.pack("<HBB", 2500, 100, 0) * 32 for b in range(8))
    when = bytes([MIDDAY.year - 1900, MIDDAY.month, MIDDAY.day, MIDDAY.hour, MIDDAY.minute, MIDDAY.second])
    behind = bytes(10) + struct.pack("<BH6sIBI", STRONGEST, 6000, when, MIDDAY.microsecond, 0x42, 0)
    data = before + blocks + behind
    assert len(data) == 1080
    return pandar_msgs__msg__PandarPacket(stamp=NOW, data=np.frombuffer(data, np.uint8), size=len(data))


# The second packet is beyond the turn's end, so that the first one's points come out.
scan = pandar_msgs__msg__PandarScan(std_msgs__msg__Header(NOW, "lidar"), [packet(35_000), packet(100)])
(cloud,) = Hydra(Hydra.Model.PandarXT32).to_pypcd4(scan)
points = cloud.pc_data
assert len(points) == 8 * 32
assert np.allclose(np.linalg.norm([points["x"], points["y"], points["z"]], axis=0), 10.0)
first = points["stamp"][points["ring"] == 0] - MIDDAY.timestamp()
print(*(round(float(seconds)) for seconds in first))
PYTHON
seen=""
for zone in UTC JST-9; do
    line="$zone: $(TZ=$zone "$folder/venv/bin/python" "$folder/seen.py")"
    echo "$line"
    seen+="$line;"
done
if [ "$seen" = "UTC: -347 -297 -247 -197 -147 -97 -47 3;JST-9: -32747 -32697 -32647 -32597 -32547 -32497 -32447 -32397;" ]; then
    echo "as seen"
else
    echo "changed"
    exit 1
fi
