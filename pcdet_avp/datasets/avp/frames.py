"""The frames of a data set on disk that a configuration may use. No torch here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pcdet_avp.datasets.avp.made_by import check_made_by
from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE, Manifest, read_manifest
from pcdet_avp.datasets.avp.splits import SPLITS, protocol_of
from pcdet_avp.errors import RecordError


def find_frames(root: Path, dataset_cfg: Mapping, class_names: Sequence[str], split: str) -> list[str]:
    """Ids of the frames of a split (by DATA_CONFIG.SPLIT_BY), in order.

    RecordError where the data set is unfinished, was made with other settings (DATA_CONFIG), lacks a class, or has no
    frame in the split.
    """
    manifest, file = read_manifest(root), root / MANIFEST_FILE
    if not manifest.complete:
        raise RecordError(f"{file}: complete: the data set is unfinished; {_remedy(manifest)}")
    check_made_by(manifest, dataset_cfg, root)
    missing = [name for name in class_names if name not in manifest.class_names]
    if missing:
        raise RecordError(f"{file}: class_names: holds {list(manifest.class_names)}, but {missing[0]!r} is asked for")
    protocol = protocol_of(dataset_cfg)
    frame_ids = manifest.frame_ids(split, protocol)
    if not frame_ids:
        counts = {name: len(manifest.frame_ids(name, protocol)) for name in SPLITS}
        raise RecordError(f"{file}: scenes: no frame in split {split!r}; frames: {counts}")
    return frame_ids


def _remedy(manifest: Manifest) -> str:
    """How the rest is made: by whatever began it."""
    for key, tool in (("GENERATE", "create_data"), ("IMPORT", "import_data")):
        if key in manifest.generator:
            return f"make the rest with tools/{tool}.py"
    return "add the frames that it lists, and set complete to true"
