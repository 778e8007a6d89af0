#!/bin/bash
# torch-kitti 1.0.1 (KITTI's raw drives), IMUData: the acceleration to the side, ay, is the one upwards, some 9.8 m/s2.
#
# A file of oxts holds 30 numbers; of these ax, ay and az are the acceleration "in direction of vehicle front", left and top
# (KITTI's dataformat.txt), and as of any accelerometer gravity is in them. The list of names that the numbers are given has
# ay twice and no az: the value of the side is overwritten by that of the top. A car that stands is in a bend of one g;
# whoever levels a LiDAR by ax and ay lays it on its side. The other 28 values are right, af, al and au in level axes among
# them. The repository has the same list, and its test, too.
#
# Way out: al, or the numbers by their place in the file: ax, ay, az are the 12th to the 14th.
#
# Seen (2026-11-30), a file of the numbers 1 to 30: attributes by name
#     ax 12, ay 14, az missing, af 15, al 16, au 17, wx 18, orimode 30
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# The file's reader needs numpy; the packages above it import torch, torchvision and others.
"$folder/venv/bin/pip" install --quiet --no-deps torch-kitti==1.0.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

for name in ("torch_kitti", "torch_kitti.raw"):
    package = sys.modules[name] = ModuleType(name)
    package.__path__ = [str(Path(sysconfig.get_path("purelib"), *name.split(".")))]

from torch_kitti.raw.inertial_measurement_unit import IMUData

Path("0000000000.txt").write_text(" ".join(str(number) for number in range(1, 31)) + "\n")
data = IMUData.open("0000000000.txt")
names = ("ax", "ay", "az", "af", "al", "au", "wx", "orimode")
found = ", ".join(f"{name} {getattr(data, name):.0f}" if hasattr(data, name) else f"{name} missing" for name in names)
print(found)
as_seen = found == "ax 12, ay 14, az missing, af 15, al 16, au 17, wx 18, orimode 30"
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
