"""One frame with its objects in the colours of what became of them: found, or why not."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from pcdet_avp.evaluation.error_kinds import NOT_COUNTED, OBJECT_KINDS
from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.ego import EGO_FOOTPRINT, centre_in_ego
from pcdet_avp.structures.frame import Frame
from pcdet_avp.visualization.detections import as_wide_as_boxes, clouds_from_above
from pcdet_avp.visualization.draw import WIDTH_PX, camera_panel, put_text
from pcdet_avp.visualization.palette import EGO_COLOR

# In the order of OBJECT_KINDS: green, amber, blue, red, grey.
KIND_COLORS = np.array([[80, 200, 110], [250, 190, 60], [90, 150, 255], [255, 70, 70], [150, 150, 150]], np.uint8)
KIND_INKS = {kind: "#" + bytes(color).hex() for kind, color in zip(OBJECT_KINDS, KIND_COLORS, strict=True)}
DETECTED_COLOR, NOT_COUNTED_COLOR = (255, 255, 255), (80, 80, 80)
LEGEND_PX = 40


def miss_picture(
    frame: Frame, grid: BevGrid, title: str, found: Detections, kinds: Mapping[str, np.ndarray]
) -> np.ndarray:
    """(H, 1600, 3) uint8 RGB: cameras of ``frame`` on the left, the view from above on the right, the colours below.

    ``kinds``: class -> index into ``OBJECT_KINDS`` of its objects in the order of the labels (the ego left out). From
    above, detections are white and objects that are not counted are dark.
    """
    labels = frame.labels.select(~centre_in_ego(frame.labels.boxes))
    kind = np.full(len(labels.boxes), NOT_COUNTED)
    for name, values in kinds.items():
        kind[labels.names == name] = values
    counted = kind != NOT_COUNTED
    boxes, colors, half = labels.boxes[counted], KIND_COLORS[kind[counted]], WIDTH_PX // 2
    panels = [camera_panel(frame.ego, boxes, colors, f"{frame.frame_id}, vehicle camera", half)]
    if frame.infra is not None and frame.infra.image is not None:
        in_infra = transform_boxes(frame.ego_from_infra.inverse(), boxes)
        panels.append(camera_panel(frame.infra, in_infra, colors, "roadside camera", half))
    canvas = clouds_from_above(frame, as_wide_as_boxes(grid, [labels.boxes, found.boxes]), half)
    canvas.image = cv2.resize(canvas.image, (half, len(canvas.image)))  # rounding may have left a pixel
    canvas.boxes(EGO_FOOTPRINT, np.array([EGO_COLOR], np.uint8), thickness=1)
    canvas.boxes(labels.boxes[~counted], np.tile(np.uint8(NOT_COUNTED_COLOR), ((~counted).sum(), 1)), thickness=1)
    canvas.boxes(boxes, colors, thickness=2)
    canvas.boxes(found.boxes, np.tile(np.uint8(DETECTED_COLOR), (len(found.boxes), 1)), thickness=1)
    put_text(canvas.image, title, (12, 26))
    columns = [np.vstack(panels), canvas.image]
    height = max(map(len, columns))
    filled = [cv2.copyMakeBorder(c, 0, height - len(c), 0, 0, cv2.BORDER_CONSTANT, value=(18,) * 3) for c in columns]
    return np.vstack([np.hstack(filled), _legend()])


def _legend() -> np.ndarray:
    """(LEGEND_PX, 1600, 3): the colours and what they mean."""
    strip, x = np.full((LEGEND_PX, WIDTH_PX, 3), 18, np.uint8), 12
    entries = [*zip(OBJECT_KINDS, KIND_COLORS, strict=True)]
    for text, color in [*entries, ("detection", DETECTED_COLOR), ("not counted", NOT_COUNTED_COLOR)]:
        put_text(strip, text, (x, LEGEND_PX - 14), tuple(int(c) for c in color))
        x += 40 + 11 * len(text)
    return strip
