"""A configuration of ours as one that OpenPCDet's scripts accept: one file, plain values, and the keys they read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import yaml

from pcdet_avp import shipped
from pcdet_avp.config import plain, require
from pcdet_avp.structures.sensor_set import SENSOR_SETS

# What OpenPCDet reads although it does not use it with adam_onecycle.
UNUSED_SCHEDULE = {
    "MOMENTUM": 0.9,
    "DECAY_STEP_LIST": [],
    "LR_DECAY": 0.1,
    "LR_CLIP": 1.0e-07,
    "LR_WARMUP": False,
    "WARMUP_EPOCH": 1,
}
HEADER = """\
# {source} for OpenPCDet's own scripts. Made by: python tools/export_openpcdet.py
#   python -m pcdet_avp.plugin OpenPCDet/tools/train.py --cfg_file cfgs/openpcdet/{name}
#   python -m pcdet_avp.plugin OpenPCDet/tools/test.py --cfg_file cfgs/openpcdet/{name} --ckpt F
# DATA_PATH is looked for below the working directory, then beside the package pcdet_avp. Training draws one of
# TRAIN_SENSOR_SETS for every sample; a test uses SENSOR_SET: --set DATA_CONFIG.SENSOR_SET C+none
"""


def openpcdet_config(cfg: Mapping) -> dict:
    """Plain mappings: ours, a relative DATA_PATH, the combinations to train with, and what only OpenPCDet reads."""
    ours = plain(cfg)
    data, model, optimization = (require(ours, key, dict) for key in ("DATA_CONFIG", "MODEL", "OPTIMIZATION"))
    sets = list(optimization.get("SENSOR_SETS") or SENSOR_SETS)
    data = {**data, "DATA_PATH": _relative(require(data, "DATA_PATH", str)), "TRAIN_SENSOR_SETS": sets}
    post = {**require(model, "POST_PROCESSING", dict), "EVAL_METRIC": "avp"}
    return {
        **ours,
        "DATA_CONFIG": data,
        "MODEL": {**model, "POST_PROCESSING": post},
        "OPTIMIZATION": {**UNUSED_SCHEDULE, **optimization},
    }


def _relative(path: str) -> str:
    """A path relative to our checkout (for an installed package: to the working folder), if it lies there."""
    relative = os.path.relpath(path, shipped.home())
    return path if relative.startswith(os.pardir) else Path(relative).as_posix()


def openpcdet_yaml(cfg: Mapping, source: str, name: str) -> str:
    """``openpcdet_config`` as the text of a file ``name``; ``source`` says whose it is."""
    header = HEADER.format(source=source, name=name)
    return header + "\n" + yaml.safe_dump(openpcdet_config(cfg), sort_keys=False, default_flow_style=None, width=110)
