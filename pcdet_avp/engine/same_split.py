"""Whether weights were trained on frames that a split of DATA_CONFIG.SPLIT_BY holds back.

By scene and by frame the same data set is split otherwise: what the one trains on, the other tests on. The same holds
for generated data sets of one seed and unequal size: scene k is the same one in both, its split is not.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcdet_avp.config import require
from pcdet_avp.datasets.avp.made_by import describes
from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE, Manifest, planned_scenes, read_manifest
from pcdet_avp.datasets.avp.splits import BY_SCENE, protocol_of
from pcdet_avp.errors import CheckpointError

TRAIN = "train"


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


def seen_before(content: Mapping[str, Any], dataset: Any) -> str:
    """A sentence that says how many frames of a data set's split are of scenes that a checkpoint was trained on in a
    data set of another size; empty where none is, where the files do not tell, and for the training split."""
    root = getattr(dataset, "root_path", None)
    if root is None or not (Path(root) / MANIFEST_FILE).exists():  # a data set class of the user's own
        return ""
    if dataset.split == TRAIN:
        return ""
    frames, trained = dataset.frame_ids, _trained_on(content, read_manifest(root))
    seen = sum(frame_id in trained or frame_id.partition("/")[0] in trained for frame_id in frames)
    if not seen:
        return ""
    return (
        f"{seen} of the {len(frames)} frames of split {dataset.split!r} are of scenes that these weights were TRAINED "
        "on, in a data set of another size from the same seed: this is no result on unseen scenes."
    )


def _trained_on(content: Mapping[str, Any], manifest: Manifest) -> set[str]:
    """Scenes (by SPLIT_BY scene) or frames of a generated data set that a checkpoint was trained on."""
    theirs = (content.get("config") or {}).get("DATA_CONFIG") or {}
    generate = theirs.get("GENERATE")
    if not generate or "GENERATE" not in manifest.generator or not describes(theirs, manifest):
        return set()
    scenes = planned_scenes(generate, manifest.seed, generate["SCENES"] * generate["FRAMES_PER_SCENE"])
    planned = Manifest(scenes, seed=manifest.seed, generator={"GENERATE": dict(generate)})
    protocol = protocol_of(theirs)
    frames = planned.frame_ids(TRAIN, protocol)
    if (content.get("sampler") or {}).get("samples", len(frames)) != len(frames):
        return set()  # its data had another size than its configuration says (tools/create_data.py --frames)
    return {frame.partition("/")[0] for frame in frames} if protocol == BY_SCENE else set(frames)


def _same_data(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> bool:
    """Whether a DATA_CONFIG describes the data of another: by what they were made from, or else by their folder."""
    root = Path(require(ours, "DATA_PATH", str))
    manifest = read_manifest(root)
    if "GENERATE" in manifest.generator and "GENERATE" in theirs:
        return describes(theirs, manifest)
    return Path(str(theirs.get("DATA_PATH"))) == root
