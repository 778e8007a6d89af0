"""What a network's weights mean: the part of a configuration that decides how inputs and outputs are to be read.

Weights of equal shapes may mean different things: classes in another order, depth bins of another range, a LiDAR at
another height. ``meaning_of`` turns a configuration into a flat mapping (dotted key -> plain value), which travels in
every checkpoint; ``differences`` compares two of them. Every key counts unless ``FREE`` lists it, so that a key that
is new cannot be forgotten here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pcdet_avp.config import plain

NETWORK_CODE = 1  # raised whenever the code computes something else from the same weights and configuration
CODE_KEY = "NETWORK_CODE"
SHOWN = 3  # differences that a message spells out

# Sections and keys that say how data are made, how the network is trained, how its boxes are filtered and what its maps
# may take on the air.
FREE = (
    "DATA_CONFIG.DATASET",
    "DATA_CONFIG.DATA_PATH",
    "DATA_CONFIG.DATA_SPLIT",
    "DATA_CONFIG.DATA_AUGMENTOR",
    "DATA_CONFIG.DEPTH_DOWNSAMPLE",
    "DATA_CONFIG.GENERATE",
    "DATA_CONFIG.POINT_FEATURE_ENCODING.encoding_type",
    "DATA_CONFIG.POINT_FEATURE_ENCODING.src_feature_list",
    "DATA_CONFIG.ROADSIDE_UNIT",
    "DATA_CONFIG.ROADSIDE_UNITS",
    "DATA_CONFIG.SENSOR_SET",
    "DATA_CONFIG.SPLIT_BY",
    "DATA_CONFIG.TRAIN_SENSOR_SETS",
    "MODEL.CAMERA_ENCODER.DEPTH.LOSS",
    "MODEL.CAMERA_ENCODER.IMAGE_BACKBONE.PRETRAINED",
    "MODEL.COMPRESSION.CONSTANT_SIZE",
    "MODEL.COMPRESSION.INITIAL_LENGTH",
    "MODEL.COMPRESSION.LOSS_WEIGHT",
    "MODEL.COMPRESSION.MAX_BYTES",
    "MODEL.DENSE_HEAD.LOSS_CONFIG",
    "MODEL.IGNORE_CONFIG",
    "MODEL.POST_PROCESSING",
    "MODEL.REGISTRATION",
    "MODEL.ROADSIDE_MAP_DROPOUT",
    "MODEL.ROADSIDE_SEGMENT_DROPOUT",
)
ATTENTIONS = tuple(f"MODEL.{name}.ATTENTION" for name in ("CAMERA_ENCODER", "LIDAR_ENCODER", "BACKBONE_2D"))
# What a section means where it leaves a key out.
DEFAULTS = {
    CODE_KEY: 1,
    "DATA_CONFIG.SENSORS.EGO.LIDAR.MATERIAL_INTENSITY": True,
    "DATA_CONFIG.SENSORS.INFRA.LIDAR.MATERIAL_INTENSITY": True,
    "MODEL.CAMERA_ENCODER.IMAGE_BACKBONE.BLOCK": "basic",
    "MODEL.CAMERA_ENCODER.IMAGE_BACKBONE.STEM_KIND": "conv",
    "MODEL.CAMERA_ENCODER.MAP_TO_BEV.SAMPLING": "trilinear",
    "MODEL.COMPRESSION.MAX_SHARE": 1.0,
    "MODEL.COMPRESSION.PRECISION": "float16",
    "MODEL.COMPRESSION.REDUCTION": 8,
    "MODEL.COMPRESSION.THRESHOLD": "learned",
    "MODEL.DENSE_HEAD.DIR_OFFSET": math.pi / 4,
    "MODEL.DENSE_HEAD.NUM_DIR_BINS": 2,
    "MODEL.DENSE_HEAD.USE_DIRECTION_CLASSIFIER": True,
    "MODEL.FUSER.ORIGINAL_FORM": False,
    "MODEL.LIDAR_ENCODER.VFE.USE_ABSLOTE_XYZ": True,
    "MODEL.SHARE_ENCODERS": False,
    **{f"{section}.{key}": value for section in ATTENTIONS for key, value in (("HEADS", 4), ("POINTS", 4))},
    **{f"{section}.QUERY_STRIDE": 1 for section in ATTENTIONS},
}
NORMALISED = ("CAMERA_ENCODER.IMAGE_BACKBONE", "CAMERA_ENCODER.DEPTH", "LIDAR_ENCODER.VFE", "BACKBONE_2D")
ANCHOR_KEYS = ("anchor_sizes", "anchor_rotations", "anchor_bottom_heights", "align_center")  # the others only train
LIGHT_RESNET = ("BLOCK", "BLOCKS", "STEM", "STEM_KIND", "WIDTHS")  # of an image backbone that is no published one

# Keys whose change no training can make good, since it scrambles what the weights have learned to say.
SCRAMBLED = (
    CODE_KEY,
    "CLASS_NAMES",
    "DATA_CONFIG.POINT_FEATURE_ENCODING",
    "MODEL.CAMERA_ENCODER.DEPTH.MODE",
    "MODEL.CAMERA_ENCODER.DEPTH.NUM_BINS",
    "MODEL.CAMERA_ENCODER.DEPTH.RANGE_M",
    "MODEL.DENSE_HEAD",
    *(f"{section}.{key}" for section in ATTENTIONS for key in ("HEADS", "POINTS")),
)


def _encoders(modality: str, *agents: str) -> tuple[str, ...]:
    """Beginnings of the names of the tensors that read these agents' camera or LiDAR."""
    return (f"encoders.{modality}.", *(f"encoders.{agent}_{modality}." for agent in agents or ("ego", "infra")))


# Beginnings of the names of the tensors that a section is about; a key of no listed section is about all.
PARTS = {
    "CLASS_NAMES": ("dense_head.",),
    "DATA_CONFIG.IMAGE_SHAPE": _encoders("camera"),
    "DATA_CONFIG.POINT_FEATURE_ENCODING": _encoders("lidar"),
    "DATA_CONFIG.SENSORS.EGO.CAMERA": _encoders("camera", "ego"),
    "DATA_CONFIG.SENSORS.EGO.LIDAR": _encoders("lidar", "ego"),
    "DATA_CONFIG.SENSORS.INFRA.CAMERA": _encoders("camera", "infra"),
    "DATA_CONFIG.SENSORS.INFRA.LIDAR": _encoders("lidar", "infra"),
    "MODEL.CAMERA_ENCODER": _encoders("camera"),
    "MODEL.CAMERA_ENCODER.CROP_TOP_PX.ego": _encoders("camera", "ego"),
    "MODEL.CAMERA_ENCODER.CROP_TOP_PX.infra": _encoders("camera", "infra"),
    "MODEL.CAMERA_ENCODER.DEPTH.RANGE_M.ego": _encoders("camera", "ego"),
    "MODEL.CAMERA_ENCODER.DEPTH.RANGE_M.infra": _encoders("camera", "infra"),
    "MODEL.LIDAR_ENCODER": _encoders("lidar"),
    "MODEL.COMPRESSION": ("codec.",),
    "MODEL.FUSER": ("fuser.",),
    "MODEL.BACKBONE_2D": ("backbone_2d.",),
    "MODEL.DENSE_HEAD": ("dense_head.",),
}


@dataclass(frozen=True)
class Difference:
    """A key with its value on either side; None where a side has nothing under it."""

    key: str
    theirs: Any
    ours: Any

    @property
    def scrambles(self) -> bool:
        """Whether further training cannot make it good."""
        return below(self.key, SCRAMBLED)

    def concerns(self, tensors: Iterable[str]) -> bool:
        """Whether any of these tensors, by name, is what the key is about."""
        sections = [section for section in PARTS if below(self.key, (section,))]
        return not sections or any(name.startswith(PARTS[max(sections, key=len)]) for name in tensors)

    def __str__(self) -> str:
        return f"{self.key} is {self.theirs!r} in the file and {self.ours!r} here"


def meaning_of(cfg: Mapping) -> dict[str, Any]:
    """Meaning of weights: CLASS_NAMES, DATA_CONFIG and MODEL as plain values by key, as far as they are there."""
    known = {key: plain(cfg[key]) for key in ("CLASS_NAMES", "DATA_CONFIG", "MODEL") if key in cfg}
    if "MODEL" in known:
        known["MODEL"] = _normalised(known["MODEL"])
    flat = {key: value for key, value in _flat(known, "") if not below(key, FREE)}
    sections = {section for key in flat for section in _sections_of(key)}
    defaults = {key: value for key, value in DEFAULTS.items() if key.rpartition(".")[0] in sections}
    flat = defaults | {key: value for key, value in flat.items() if value is not None or key not in DEFAULTS}
    return dict(sorted(flat.items())) | {CODE_KEY: NETWORK_CODE}


def differences(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> list[Difference]:
    """Every key whose values differ, but for rounding, by name; nothing of top sections that one side lacks."""
    tops = [{key.partition(".")[0] for key in meaning} for meaning in (theirs, ours)]
    keys = [key for key in sorted({*theirs, *ours}) if all(key.partition(".")[0] in known for known in tops)]
    pairs = [Difference(key, _value(theirs, key), _value(ours, key)) for key in keys]
    return [pair for pair in pairs if not _same(pair.theirs, pair.ours)]


def some_of(found: Sequence[Difference]) -> str:
    """The first differences in words."""
    more = f", and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return "; ".join(map(str, found[:SHOWN])) + more


def below(key: str, sections: Iterable[str]) -> bool:
    """Whether a dotted key is one of these, or lies in one of them."""
    return any(key == section or key.startswith(f"{section}.") for section in sections)


def _value(meaning: Mapping[str, Any], key: str) -> Any:
    """What a file that was written before a key existed means by it."""
    section = key.rpartition(".")[0]
    known = not section or any(other.startswith(f"{section}.") for other in meaning)
    return meaning.get(key, DEFAULTS.get(key) if known else None)


def _same(theirs: Any, ours: Any) -> bool:
    if isinstance(theirs, list) and isinstance(ours, list):
        return len(theirs) == len(ours) and all(map(_same, theirs, ours))
    if isinstance(theirs, int | float) and isinstance(ours, int | float):
        return math.isclose(theirs, ours, rel_tol=1e-6, abs_tol=1e-9)
    return theirs == ours


def _flat(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    if not isinstance(value, dict) or not value:
        yield key, value
        return
    for name, item in value.items():
        yield from _flat(item, f"{key}.{name}" if key else str(name))


def _sections_of(key: str) -> Iterator[str]:
    while key:
        key = key.rpartition(".")[0]
        yield key


def _normalised(model: dict) -> dict:
    """MODEL as the network reads it: one NORM per section, anchors by class, and nothing that has no effect."""
    model = dict(model)
    norm = model.pop("NORM", "group")
    width = {"FFN_CHANNELS": model.get("NUM_BEV_FEATURES")}
    for path in NORMALISED:
        model = _changed(model, path, lambda section: {"NORM": norm} | section)
    for path in ("CAMERA_ENCODER.ATTENTION", "LIDAR_ENCODER.ATTENTION"):
        model = _changed(model, path, lambda section: width | section if section else None)
    model = _changed(model, "CAMERA_ENCODER", _with_crops)
    model = _changed(model, "CAMERA_ENCODER.IMAGE_BACKBONE", _without_unused_blocks)
    model = _changed(model, "COMPRESSION", _without_unused_share)
    return _changed(model, "DENSE_HEAD", _with_anchors_by_class)


def _changed(model: dict, path: str, change) -> dict:
    """A copy in which ``change`` was applied to the section at ``path``, if there is one."""
    key, _, rest = path.partition(".")
    if not isinstance(model.get(key), dict):
        return model
    return {**model, key: _changed(model[key], rest, change) if rest else change(model[key])}


def _with_crops(section: dict) -> dict:
    return {**section, "CROP_TOP_PX": {"ego": 0, "infra": 0} | (section.get("CROP_TOP_PX") or {})}


def _without_unused_blocks(section: dict) -> dict:
    unused = LIGHT_RESNET if section.get("DEPTH") is not None else ()
    return {key: value for key, value in section.items() if key not in unused}


def _without_unused_share(section: dict) -> dict:
    unused = () if section.get("THRESHOLD") == "rate" else ("TARGET_SHARE",)
    return {key: value for key, value in section.items() if key not in unused}


def _with_anchors_by_class(section: dict) -> dict:
    """The order of the entries has no effect: anchors are laid out in the order of CLASS_NAMES."""
    entries = section.get("ANCHOR_GENERATOR_CONFIG")
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        return section
    aligned = [{"align_center": True} | entry for entry in entries]
    by_class = {str(e.get("class_name")): {key: e[key] for key in ANCHOR_KEYS if key in e} for e in aligned}
    return {**section, "ANCHOR_GENERATOR_CONFIG": by_class}
