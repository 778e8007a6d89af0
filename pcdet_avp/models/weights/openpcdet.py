"""Weights of OpenPCDet's PointPillar into our network: pillar encoder, backbone and head, where shapes agree."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass, field

from torch import Tensor, nn

from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.backbones_3d.vfe.dynamic_pillars import DynamicPillars
from pcdet_avp.models.norm import drop_foreign_norms

ENCODER = "vfe."  # of OpenPCDet's names; ours lie below encoders.<source>.
COUNTERS = ("global_step", ".num_batches_tracked")


def is_openpcdet(state: Mapping[str, Tensor]) -> bool:
    """Whether the names are those of a pillar detector of OpenPCDet, and not of our network trained there."""
    return any(key.startswith(ENCODER) for key in state) and not any(key.startswith("encoders.") for key in state)


@dataclass
class ImportReport:
    """Result of an import, by OpenPCDet's names: the tensor that each became, or why it was left out."""

    loaded: dict[str, list[str]] = field(default_factory=dict)  # theirs -> ours
    other_shape: dict[str, str] = field(default_factory=dict)  # theirs -> "(found) here (expected)"
    other_norm: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    fresh: list[str] = field(default_factory=list)  # our names that the file has nothing for

    def lines(self) -> list[str]:
        """One line per kind of outcome, without batch norms' counters."""
        rows = [f"loaded {len(self.loaded)} tensors of OpenPCDet's into {sum(map(len, self.loaded.values()))} of ours"]
        shapes = [f"{key} {shapes}" for key, shapes in self.other_shape.items()]
        for what, names in (
            ("not loaded, of another shape", shapes),
            ("not loaded, of another normalisation (MODEL.NORM: batch would take them)", self.other_norm),
            ("not loaded, unknown here", self.unknown),
            ("not in the file, left as they are", self.fresh),
        ):
            shown = [name for name in names if not name.endswith(COUNTERS)]
            if shown:
                rows.append(f"{what}: {len(shown)}: {', '.join(shown)}")
        return rows


def match_tensors(state: Mapping[str, Tensor], model: nn.Module) -> tuple[dict[str, Tensor], ImportReport]:
    """Our names and tensors for OpenPCDet's ``state``, as far as ``model`` has room for them."""
    own, report = model.state_dict(), ImportReport()
    names = {key: targets_of(key, own) for key in state if key != "global_step"}
    renamed = {name: state[key] for key, targets in names.items() for name in targets}
    kept, foreign = drop_foreign_norms(renamed, model)
    matched = {name: value for name, value in kept.items() if name in own and own[name].shape == value.shape}
    for key, targets in names.items():
        known = [name for name in targets if name in own]
        if used := [name for name in targets if name in matched]:
            report.loaded[key] = used
        elif set(targets) & set(foreign):
            report.other_norm.append(key)
        elif known:
            report.other_shape[key] = f"{tuple(state[key].shape)} here {tuple(own[known[0]].shape)}"
        else:
            report.unknown.append(key)
    report.fresh = [name for name in own if name not in matched and name != "global_step"]
    return matched, report


def targets_of(key: str, own: Mapping[str, Tensor]) -> list[str]:
    """Our names for one of OpenPCDet's; its pillar encoder serves every LiDAR encoder that we have."""
    if not key.startswith(ENCODER):
        return [key]
    encoders = {name.split(".")[1] for name in own if name.startswith("encoders.") and f".{ENCODER}" in name}
    return [f"encoders.{encoder}.{key}" for encoder in sorted(encoders)]


def load_openpcdet(
    model: nn.Module, state: Mapping[str, Tensor], path: str | os.PathLike, logger: logging.Logger
) -> ImportReport:
    """Copy OpenPCDet's ``state`` into ``model``, log and return what was loaded; CheckpointError where nothing fits."""
    matched, report = match_tensors(state, model)
    if not report.loaded:
        raise CheckpointError(f"{path}: OpenPCDet's, but none of its {len(state)} tensors fits this configuration")
    model.load_state_dict(matched, strict=False)
    for line in report.lines():
        logger.info("%s: %s", path, line)
    if any(isinstance(module, DynamicPillars) and module.as_openpcdet is None for module in model.modules()):
        logger.warning(
            "%s: its pillars count heights from the LiDAR, ours from the floor; MODEL.LIDAR_ENCODER.VFE.AS_OPENPCDET "
            "tells how high it stood (KITTI: 1.73 m)",
            path,
        )
    return report
