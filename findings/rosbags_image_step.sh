#!/bin/bash
# rosbags-image 0.10.4 (ROS images without ROS): rows that the driver padded come out sheared, and a depth image in a
# CompressedImage comes out in 8 bits.
#
# sensor_msgs/Image has step, the "full row length in bytes", because drivers align rows: of a width that is no multiple of
# 4, 16 or 64 bytes the rest of a row is filler (V4L2's bytesperline). message_to_cvimage does not look at step; it takes
# width x height pixels from the front. Every row is pushed a few pixels further to the right than the one above, the filler
# is in the picture and its end is missing. Nothing is said. Usual widths, 640 or 1920, need no filler.
# image_transport's "compressed" keeps 16-bit depth as a 16-bit PNG ("16UC1; png compressed"), in millimetres. The bytes are
# decoded with a flag that asks for any colour and not for any depth, so that OpenCV makes 8 bits of them: what comes out
# are steps of a quarter of a metre, in an array as large as it should be. The same picture in an Image message keeps its
# 16 bits.
#
# Way out: np.ndarray((height, width), dtype, msg.data, strides=(msg.step, itemsize)); cv2.imdecode(msg.data,
# cv2.IMREAD_UNCHANGED).
#
# Seen (2026-11-30), three rows of 0 10 20 30 40 50 with two bytes of filler, 255, behind each; then depths in mm
#     step 6: 0 10 20 30 40 50, 0 10 20 30 40 50, 0 10 20 30 40 50
#     step 8: 0 10 20 30 40 50, 255 255 0 10 20 30, 40 50 255 255 0 10
#     1000, 1200, 20000: Image uint16 1000 1200 20000, CompressedImage uint8 3 4 78
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet rosbags-image==0.10.4 rosbags==0.11.9 numpy==2.4.6 opencv-python-headless==5.0.0.93
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import cv2
import numpy as np
from rosbags.image import message_to_cvimage
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_HUMBLE).types
HEADER = TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](sec=0, nanosec=0), "camera")


def image(encoding, pixels, filler=0):
    """A message whose rows end in ``filler`` bytes of 255."""
    rows = np.pad(pixels.view(np.uint8), ((0, 0), (0, filler)), constant_values=255)
    size = {"height": pixels.shape[0], "width": pixels.shape[1], "step": rows.shape[1]}
    kind = TYPES["sensor_msgs/msg/Image"]
    return kind(HEADER, encoding=encoding, is_bigendian=0, data=rows.ravel(), **size)


def text(pixels):
    return ", ".join(" ".join(map(str, row)) for row in pixels)


grey = np.tile(np.arange(0, 60, 10, dtype=np.uint8), (3, 1))
found = [text(message_to_cvimage(image("mono8", grey, filler))) for filler in (0, 2)]
print(f"step 6: {found[0]}\nstep 8: {found[1]}")
depth = np.array([[1000, 1200, 20000]], np.uint16)
packed = TYPES["sensor_msgs/msg/CompressedImage"](
    HEADER, format="16UC1; png compressed ", data=cv2.imencode(".png", depth)[1].ravel()
)
assert text(cv2.imdecode(packed.data, cv2.IMREAD_UNCHANGED)) == text(depth)
for message in (image("16UC1", depth), packed):
    pixels = message_to_cvimage(message)
    found.append(f"{pixels.dtype} {text(pixels)}")
print(f"{', '.join(map(str, depth[0]))}: Image {found[2]}, CompressedImage {found[3]}")
as_seen = found == [
    "0 10 20 30 40 50, 0 10 20 30 40 50, 0 10 20 30 40 50",
    "0 10 20 30 40 50, 255 255 0 10 20 30, 40 50 255 255 0 10",
    "uint16 1000 1200 20000",
    "uint8 3 4 78",
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
