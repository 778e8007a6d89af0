#!/bin/bash
# pykitti 0.3.1, raw: after a scan that a drive lacks, every LiDAR scan comes with the pose and the images of another
# frame; a choice of frames that reaches beyond the last scan gives all scans.
#
# KITTI's raw drives name files by frame, and some lack scans: 2011_09_26_drive_0009_sync has no Velodyne files 177 to
# 180, while images and poses (oxts) are there (issue 186 of mrharicot/monodepth). pykitti sorts the files that exist
# and counts them: get_velo(177) is scan 181, and so on to the end, four frames (0.4 s) off; len() is the number of
# poses. At 10 m/s that is 4 m.
# frames=[...] picks by the same count, and where a number lies beyond the end of a list (there are fewer scans than
# poses) the error is swallowed and the list stays whole: get_velo(0) is the drive's first scan.
#
# Way out: match by the number in the file's name (data.velo_files, data.oxts_files), leave out frames without a scan.
#
# Seen (2026-11-29), 8 frames, each scan and pose holding its number, scan 3 missing; pose, scan of the same index:
#     (0, 0) (1, 1) (2, 2) (3, 4) (4, 5) (5, 6) (6, 7) (7, none)
#     frames=[6, 7]: poses [6, 7], scans [0, 1, 2, 4, 5, 6, 7]
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pykitti==0.3.1 numpy==2.4.6 pillow==11.3.0 pandas==3.0.6 \
    matplotlib==3.11.2 opencv-python-headless==5.0.0.93 # pykitti imports the last without asking for it
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
import pykitti

MISSING, COUNT = 3, 8
EYE, PROJECTION = "1 0 0 0 1 0 0 0 1", "500 0 320 0 0 500 240 0 0 0 1 0"
day = Path("2011_09_26")
drive = day / "2011_09_26_drive_0001_sync"
for name in ("oxts", "velodyne_points"):
    (drive / name / "data").mkdir(parents=True)
for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
    (day / name).write_text(f"R: {EYE}\nT: 0 0 0\n")
cameras = "".join(f"P_rect_0{k}: {PROJECTION}\nR_rect_0{k}: {EYE}\n" for k in range(4))
(day / "calib_cam_to_cam.txt").write_text(cameras)
times = "".join(f"2011-09-26 13:00:00.{frame}00000000\n" for frame in range(COUNT))
(drive / "oxts/timestamps.txt").write_text(times)
for frame in range(COUNT):
    # A packet: latitude, longitude, altitude (here: the frame's number), 22 more, 5 flags.
    (drive / f"oxts/data/{frame:010d}.txt").write_text(" ".join(["49.0", "8.4", str(frame), *["0"] * 27]) + "\n")
    if frame != MISSING:
        np.full((1, 4), frame, np.float32).tofile(drive / f"velodyne_points/data/{frame:010d}.bin")


def poses_and_scans(**options):
    data = pykitti.raw(".", "2011_09_26", "0001", **options)
    poses = [int(each.packet.alt) for each in data.oxts]
    return poses, [int(data.get_velo(k)[0, 0]) for k in range(len(data.velo_files))]


poses, scans = poses_and_scans()
print(" ".join(f"({pose}, {scan})" for pose, scan in zip(poses, [*scans, "none"], strict=True)))
some_poses, some_scans = poses_and_scans(frames=[6, 7])
print(f"frames=[6, 7]: poses {some_poses}, scans {some_scans}")
as_seen = poses == list(range(COUNT)) and scans == [0, 1, 2, 4, 5, 6, 7]
as_seen &= some_poses == [6, 7] and some_scans == scans
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
