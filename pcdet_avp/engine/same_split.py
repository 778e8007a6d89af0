"""Whether weights were trained on frames that a split of DATA_CONFIG.SPLIT_BY holds back.

By scene and by frame the same data set is split otherwise: what the one trains on, the other tests on.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcdet_avp.config import require
from pcdet_avp.datasets.avp.made_by import describes
from pcdet_avp.datasets.avp.manifest import read_manifest
from pcdet_avp.datasets.avp.splits import protocol_of
from pcdet_avp.errors import CheckpointError


def check_same_split(content: Mapping[str, Any], dataset_cfg: Mapping[str, Any], path: str | os.PathLike) -> None:
    """CheckpointError where a checkpoint was trained on the data of DATA_CONFIG, split by the other protocol.

    Nothing is said of files that do not hold their configuration, and of what their weights were begun with.
    """
    theirs = (content.get("config") or {}).get("DATA_CONFIG")
    if not theirs:
        return
    found, ours = protocol_of(theirs), protocol_of(dataset_cfg)
    if found != ours and _same_data(theirs, dataset_cfg):
        raise CheckpointError(
            f"{path}: was trained on these data with DATA_CONFIG.SPLIT_BY {found!r}, the configuration says {ours!r}: "
            "frames that it was trained on would be validated and tested on; "
            f"--set DATA_CONFIG.SPLIT_BY {found}, or other weights"
        )


def _same_data(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> bool:
    """Whether a DATA_CONFIG describes the data of another: by what they were made from, or else by their folder."""
    root = Path(require(ours, "DATA_PATH", str))
    manifest = read_manifest(root)
    if "GENERATE" in manifest.generator and "GENERATE" in theirs:
        return describes(theirs, manifest)
    return Path(str(theirs.get("DATA_PATH"))) == root
