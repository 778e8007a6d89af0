"""Data sets: records on disk, and what the network is fed with. Importing this package costs nothing."""

from __future__ import annotations

import logging

from pcdet_avp.config import require
from pcdet_avp.registry import DATASETS


def build_dataset(
    dataset_cfg,
    class_names: list[str],
    training: bool,
    split: str | None = None,
    logger: logging.Logger | None = None,
    **options,
):
    """The data set that ``DATA_CONFIG.DATASET`` names; ``split`` overrides ``DATA_SPLIT`` ('train', 'val', 'test').

    ``options`` go to its class as they are.
    """
    from pcdet_avp.datasets.avp import avp_dataset  # noqa: F401  torch is imported, and the class registered, only here

    cls = DATASETS[require(dataset_cfg, "DATASET", str)]
    required = {"dataset_cfg": dataset_cfg, "class_names": class_names, "training": training}
    return cls(**required, logger=logger, split=split, **options)


def has_split(dataset_cfg, split: str) -> bool:
    """Whether a split of the data set has any frame."""
    from pcdet_avp.datasets.avp.manifest import read_manifest
    from pcdet_avp.datasets.avp.splits import protocol_of

    manifest = read_manifest(require(dataset_cfg, "DATA_PATH", str))
    return bool(manifest.frame_ids(split, protocol_of(dataset_cfg)))
