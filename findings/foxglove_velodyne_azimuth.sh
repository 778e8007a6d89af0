#!/bin/bash
# @foxglove/velodyne-cloud 1.0.1 (Velodyne packets to clouds, made for Foxglove Studio), VLP-16: the sensor stands still
# for a block and jumps, and times are off by a factor of 2.5 within a firing and of 10^12 between packets.
#
# A block of a packet holds two firings of 16 lasers, one laser after the other, and the azimuth of the first one alone. That of
# the others follows from the azimuth of the next block (VLP-16 manual, "Precision Azimuth Calculation"; velodyne_pointcloud of
# ROS does so). Transformer works this azimuth out, compares it with minAngle and maxAngle, and then places the point by the
# block's azimuth. At 10 Hz all 32 shots of a block stand on one line of azimuth, up to a third of a degree back, 0.11 m at
# 20 m, and twice that at 20 Hz: an upright edge has steps. VLS-128 goes the same way.
# The table of times has the laser's number over 16 in it where its firing, 0 or 1, is meant, so that deltaNs of laser 15 comes
# out at 86 instead of 35 us and goes back by 31 us at the second firing.
# RawPacket.timestamp(), "fractional seconds since the UNIX epoch", divides microseconds by 1e-6 instead of multiplying. The
# README's example has its clouds' stamp from there: the second after the full hour is 31,688 years away, and deltaNs of a later
# packet, which has 32 bits for nanoseconds, is any number. The package's test takes two stamps of its own and the first point.
#
# Way out: turn each point on by what the manual gives for its laser and firing (point.azimuth is the block's), times from the
# manual's table, and the packet's gpsTimestamp * 1e-6 for stamps.
#
# Seen (2026-12-01, Node.js 20), 0.4 degrees from block to block, all echoes at 20 m: azimuth in degrees and time in us of a
# point, then what the manual says
#     firing 0, laser 0: 0.000, 0.0; 0.000, 0.0
#     firing 0, laser 15: 0.000, 86.4; 0.125, 34.6
#     firing 1, laser 0: 0.000, 55.3; 0.200, 55.3
#     firing 1, laser 15: 0.000, 141.7; 0.325, 89.9
#     timestamp() 1 s after the full hour: 1000000000000
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install @foxglove/velodyne-cloud@1.0.1 --silent --no-audit --no-fund
cat >look.cjs <<'JAVASCRIPT'
const { Calibration, PointCloud, RawPacket, Transformer } = require("@foxglove/velodyne-cloud");

const STEP = 0.4; // degrees from block to block
const FIRING = 55.296; // us
const LASER = 2.304;

const data = new Uint8Array(1206);
const view = new DataView(data.buffer);
for (let block = 0; block < 12; block++) {
  view.setUint16(100 * block, 0xeeff, true);
  view.setUint16(100 * block + 2, 100 * STEP * block, true);
  for (let shot = 0; shot < 32; shot++) {
    view.setUint16(100 * block + 4 + 3 * shot, 20 / 0.002, true);
    view.setUint8(100 * block + 6 + 3 * shot, 100);
  }
}
view.setUint32(1200, 1e6, true); // us since the full hour
view.setUint8(1204, 0x37); // strongest return
view.setUint8(1205, 0x22); // VLP-16

const packet = new RawPacket(data);
const cloud = new PointCloud({ stamp: 0, maxPoints: RawPacket.MAX_POINTS_PER_PACKET });
new Transformer(new Calibration(packet.inferModel())).unpack(packet, 0, 0, cloud);

const found = [];
for (const [firing, laser] of [[0, 0], [0, 15], [1, 0], [1, 15]]) {
  const { x, y, deltaNs } = cloud.point(16 * firing + laser);
  const azimuth = Math.abs((Math.atan2(-y, x) * 180) / Math.PI);
  const time = firing * FIRING + laser * LASER;
  const real = `${((STEP * time) / (2 * FIRING)).toFixed(3)}, ${time.toFixed(1)}`;
  found.push(`firing ${firing}, laser ${laser}: ${azimuth.toFixed(3)}, ${(deltaNs / 1000).toFixed(1)}; ${real}`);
}
found.push(`timestamp() 1 s after the full hour: ${packet.timestamp(new Date(0)).toFixed(0)}`);
console.log(found.join("\n"));
const same =
  found.join("\n") ===
  [
    "firing 0, laser 0: 0.000, 0.0; 0.000, 0.0",
    "firing 0, laser 15: 0.000, 86.4; 0.125, 34.6",
    "firing 1, laser 0: 0.000, 55.3; 0.200, 55.3",
    "firing 1, laser 15: 0.000, 141.7; 0.325, 89.9",
    "timestamp() 1 s after the full hour: 1000000000000",
  ].join("\n");
console.log(same ? "as seen" : "changed");
process.exit(same ? 0 : 1);
JAVASCRIPT
node look.cjs
