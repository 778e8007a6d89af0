"""Which scenes are trained on, validated on and tested on. By default whole scenes: neighbours in time look alike.

DATA_CONFIG.SPLIT_BY ``frame`` is the paper's protocol instead: every frame of every scene is drawn into a split. It is
read with the data, so that one data set on disk serves both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from pcdet_avp.errors import ConfigError, RecordError

SPLITS = ("train", "val", "test")
BY_SCENE, BY_FRAME = PROTOCOLS = ("scene", "frame")
TEST_SHARE = 0.2  # paper: 80:20
VAL_SHARE = 0.1  # of the scenes (or frames) that are not tested on


def protocol_of(dataset_cfg: Mapping[str, Any]) -> str:
    """DATA_CONFIG.SPLIT_BY, ``scene`` where it is absent; ConfigError for anything but ``scene`` and ``frame``."""
    protocol = dataset_cfg.get("SPLIT_BY", BY_SCENE)
    if protocol not in PROTOCOLS:
        raise ConfigError(f"DATA_CONFIG.SPLIT_BY: expected {' or '.join(PROTOCOLS)}, found {protocol!r}")
    return protocol


def split_shares(generate: Mapping[str, Any]) -> tuple[float, float]:
    """GENERATE.SPLIT: {test: of all scenes, val: of the scenes that are not tested on}; by default the paper's."""
    shares = {"test": TEST_SHARE, "val": VAL_SHARE} | dict(generate.get("SPLIT", {}))
    if set(shares) != {"test", "val"}:
        unknown = min(set(shares) - {"test", "val"})
        raise ConfigError(f"DATA_CONFIG.GENERATE.SPLIT: unknown key {unknown!r}; known: test, val")
    for name, share in shares.items():
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0 <= share < 1:
            raise ConfigError(
                f"DATA_CONFIG.GENERATE.SPLIT.{name}: expected a share of at least 0 and below 1, found {share!r}"
            )
    return float(shares["test"]), float(shares["val"])


def assign_splits(
    names: Iterable[str], seed: int, test_share: float = TEST_SHARE, val_share: float = VAL_SHARE
) -> dict[str, str]:
    """name of a scene (or frame) -> split. Depends on the names and the seed, not on their order.

    Shares are rounded to whole scenes; with three scenes or more, each split whose share is not 0 gets at least one.
    """
    names = sorted(names)
    if len(set(names)) != len(names):
        raise RecordError(f"a scene is listed twice: {sorted({n for n in names if names.count(n) > 1})}")
    least = 1 if len(names) >= len(SPLITS) else 0
    test = max(round(test_share * len(names)), least if test_share else 0)
    val = max(round(val_share * (len(names) - test)), least if val_share else 0)
    shuffled = np.random.default_rng(seed).permutation(names).tolist()
    split = ["test"] * test + ["val"] * val + ["train"] * (len(names) - test - val)
    assigned = dict(zip(shuffled, split, strict=True))
    return {name: assigned[name] for name in names}


def split_name(split: str, protocol: str) -> str:
    """For folders: ``test``, or ``test_by_frame``."""
    return split if protocol == BY_SCENE else f"{split}_by_{protocol}"


def protocol_line(split: str, protocol: str) -> str:
    """What a result on a split stands for, in a sentence."""
    if protocol == BY_SCENE:
        return f"Split {split!r}, by scene: no frame of its scenes is in another split."
    return (
        f"Split {split!r}, by FRAME (the paper's protocol): other frames of the same scenes, moments apart, are in the "
        "training split. Not to be compared with results by scene."
    )
