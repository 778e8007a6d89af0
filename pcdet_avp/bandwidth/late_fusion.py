"""The object-level alternative: the roadside sends boxes, and the vehicle merges them with its own.

Both lists come from the same network, once with the vehicle's sources only and once with the roadside's only, the
latter in the vehicle's frame: the network fuses there, and what it finds does not depend on who runs it. The size of
the message is that of ETSI's Collective Perception Message (ETSI TS 103 324): about 121 B and 35 B for every object.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pcdet_avp.models.dense_heads.rotated_nms import rotated_nms
from pcdet_avp.models.detectors.post_processing import PostProcessing
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.pose import Pose

MESSAGE_BYTES, OBJECT_BYTES = 121, 35


class Boxes(NamedTuple):
    """Detections of one frame: boxes (n, 7), scores (n,), labels (n,) from 1."""

    boxes: Tensor
    scores: Tensor
    labels: Tensor

    def select(self, rows: Tensor) -> Boxes:
        """The rows of a mask (n,) or of indices."""
        return Boxes(*(column[rows] for column in self))


def message_bytes(objects: int) -> int:
    """Bytes of a message about so many objects."""
    return MESSAGE_BYTES + OBJECT_BYTES * objects


def merge(vehicle: Boxes, roadside: Boxes, post_processing: PostProcessing) -> Boxes:
    """Both lists, thinned by the network's own suppression within each class; best first."""
    both = Boxes(*(torch.cat(pair) for pair in zip(vehicle, roadside, strict=True)))
    kept = torch.cat([_survivors(both, k, post_processing) for k in range(len(post_processing.max_overlaps))])
    return both.select(kept[both.scores[kept].argsort(descending=True, stable=True)])


def _survivors(both: Boxes, k: int, post_processing: PostProcessing) -> Tensor:
    rows = (both.labels == k + 1).nonzero().squeeze(1)
    most = 2 * post_processing.post_max  # both lists are complete
    return rows[rotated_nms(both.boxes[rows], both.scores[rows], post_processing.max_overlaps[k], most, most)]


def in_roadside_range(found: Boxes, ego_from_infra: np.ndarray, grid: BevGrid) -> Boxes:
    """Those whose centre lies on the roadside's own map: elsewhere it has seen nothing."""
    infra_from_ego = Pose(ego_from_infra).inverse()
    centres = transform_boxes(infra_from_ego, found.boxes.cpu().numpy().astype(np.float64))
    return found.select(torch.from_numpy(grid.contains_bev(centres)).to(found.scores.device))
