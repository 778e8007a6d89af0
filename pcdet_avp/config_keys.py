"""Every key that a configuration may hold, with the rule for its value; ``*`` stands for any item of a list."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pcdet_avp.config_rules import (
    ANY,
    BETWEEN,
    COUNT,
    COUNT_FROM_0,
    ELEVATION,
    FACTORS,
    FIELD_OF_VIEW,
    FLAG,
    FROM_0,
    FROM_1,
    NAMES,
    NUMBER,
    POSITIVE,
    SHARE,
    SHARE_ABOVE_0,
    TEXT,
    TURN,
    Rule,
    one_of,
)

CAMERA = {
    "WIDTH": COUNT,
    "HEIGHT": COUNT,
    "HFOV_DEG": FIELD_OF_VIEW,
    "X_M": NUMBER,
    "Z_M": POSITIVE,
    "PITCH_DOWN_DEG": ELEVATION,
}
LIDAR = {
    "BEAMS": COUNT,
    "COLUMNS": COUNT,
    "ELEVATION_MIN_DEG": ELEVATION,
    "ELEVATION_MAX_DEG": ELEVATION,
    "AZIMUTH_SPAN_DEG": TURN,
    "X_M": NUMBER,
    "Z_M": POSITIVE,
    "PITCH_DOWN_DEG": ELEVATION,
    "DROP_OFF": SHARE,
    "RANGE_NOISE_M": FROM_0,
    "MATERIAL_INTENSITY": FLAG,
}
ROADSIDE_UNIT = {
    "X_M": NUMBER,
    "Y_M": NUMBER,
    "Z_M": POSITIVE,
    "YAW_DEG": NUMBER,
    "PITCH_DOWN_DEG": ELEVATION,
    "CAMERA": FLAG,
    "LIDAR": FLAG,
}
RANGE, SHARES, COUNTS = FROM_0.list_of(2), SHARE.list_of(2), COUNT_FROM_0.list_of(2)
ZONE = {"SHARE": SHARE, "BEFORE_MAST_M": RANGE, "JUNCTION_SHARE": SHARE}
COUNTED = ("IN_GAP", "CROSSING", "ALONG", "ON_SIDE_ROAD", "AT_JUNCTION", "SAME_LANE", "OPPOSITE_LANE")
GARAGE = {
    **{f"{name}_M": POSITIVE.list_of(2) for name in ("ROAD_LENGTH", "JUNCTION_BEFORE_MAST", "SIDE_ROAD_LENGTH")},
    **{f"{name}_M": POSITIVE.list_of(2) for name in ("PILLAR_SIZE", "PARAPET", "CEILING", "LAMP_SPACING")},
    "WALL_BEHIND_MAST_M": POSITIVE,
    "PILLAR_SETBACK_M": FROM_0,
    "SLOTS_PER_BAY": COUNT.list_of(2),
    "DIM_LAMP_SHARE": SHARES,
    "FAILED_LAMP_SHARE": SHARES,
}
SCENE = {
    **{f"ZONES.*.{key}": rule for key, rule in ZONE.items()},
    "EGO_SPEED_MPS": RANGE,
    "OCCUPANCY": SHARES,
    "GAP_DEPTH_M": POSITIVE,
    "VIEW_M": POSITIVE,
    **dict.fromkeys(COUNTED, COUNTS),
}
MAST = {
    **dict.fromkeys(("HEIGHT_M", "AIM_M", "CEILING_ABOVE_M"), POSITIVE.list_of(2)),
    "PITCH_DOWN_DEG": ELEVATION.list_of(2),
    **dict.fromkeys(("YAW_DEG", "OFFSET_M"), NUMBER.list_of(2)),
    "LOWEST_CEILING_M": POSITIVE,
}
LATE_SIGHT = {"SHARE": SHARE, "VANS_OUT_M": NUMBER.list_of(2), "STEPPING_OUT": COUNTS, "CHILD_SHARE": SHARE}
GENERATED_SCENES = {
    f"GENERATE.{part}.{key}": rule
    for part, rules in (("GARAGE", GARAGE), ("SCENE", SCENE), ("MAST", MAST), ("LATE_SIGHT", LATE_SIGHT))
    for key, rule in rules.items()
}
DATA = {
    "DATASET": TEXT,
    "DATA_PATH": TEXT,
    "POINT_CLOUD_RANGE": NUMBER.list_of(6),
    "VOXEL_SIZE": POSITIVE.list_of(3),
    "IMAGE_SHAPE": COUNT.list_of(2),
    "DEPTH_DOWNSAMPLE": COUNT,
    **{f"ROADSIDE_UNITS.*.{key}": rule for key, rule in ROADSIDE_UNIT.items()},
    "ROADSIDE_UNIT": TEXT.or_null(),
    "DATA_SPLIT.train": TEXT,
    "DATA_SPLIT.test": TEXT,
    "SPLIT_BY": one_of("scene", "frame"),
    "SENSOR_SET": TEXT,
    "TRAIN_SENSOR_SETS": NAMES,
    "POINT_FEATURE_ENCODING.encoding_type": TEXT,
    "POINT_FEATURE_ENCODING.used_feature_list": NAMES,
    "POINT_FEATURE_ENCODING.src_feature_list": NAMES,
    "DATA_AUGMENTOR.SEED": COUNT_FROM_0,
    "DATA_AUGMENTOR.DISABLE_AUG_LIST": NAMES.or_null(),
    "DATA_AUGMENTOR.AUG_CONFIG_LIST": ANY,
    **{
        f"DATA_AUGMENTOR.AUG_CONFIG_LIST.*.{key}": rule
        for key, rule in {
            "NAME": TEXT,
            "ALONG_AXIS_LIST": NAMES,
            "PROBABILITY": SHARE,
            "WORLD_ROT_ANGLE": NUMBER.list_of(2),
            "AGENTS": NAMES,
            "WORLD_SCALE_RANGE": POSITIVE.list_of(2),
            "BRIGHTNESS": SHARE,
            "CONTRAST": FROM_0.list_of(2),
            "NOISE_STD": FROM_0,
            "POSITION_STD_M": FROM_0,
            "YAW_STD_DEG": FROM_0,
        }.items()
    },
    **{f"SENSORS.{agent}.CAMERA.{key}": rule for agent in ("EGO", "INFRA") for key, rule in CAMERA.items()},
    **{f"SENSORS.{agent}.LIDAR.{key}": rule for agent in ("EGO", "INFRA") for key, rule in LIDAR.items()},
    "GENERATE.SEED": COUNT_FROM_0,
    "GENERATE.SCENES": COUNT,
    "GENERATE.FRAMES_PER_SCENE": COUNT,
    "GENERATE.FRAME_INTERVAL_S": POSITIVE,
    **GENERATED_SCENES,
    "GENERATE.PLAN": TEXT.or_null(),
    "GENERATE.GARAGE_SEED": COUNT_FROM_0.or_null(),
    "GENERATE.SOURCES": NAMES.or_null(),
    "GENERATE.SPLIT.test": SHARE,
    "GENERATE.SPLIT.val": SHARE,
}
NORM = {"NORM": TEXT}
ATTENTION = {"HEADS": COUNT, "POINTS": COUNT, "QUERY_STRIDE": COUNT, "FFN_CHANNELS": COUNT}
CODEC = {
    "NAME": TEXT,
    "REDUCTION": COUNT,
    "PRECISION": TEXT,
    "THRESHOLD": TEXT,
    "TARGET_SHARE": SHARE_ABOVE_0,
    "MAX_SHARE": SHARE_ABOVE_0.or_null(),
    "LOSS_WEIGHT": FROM_0,
    "INITIAL_LENGTH": POSITIVE,
}
ON_THE_AIR = {"MAX_BYTES": COUNT.or_null(), "CONSTANT_SIZE": FLAG}
SECTIONS: dict[str, dict[str, Rule]] = {
    "CAMERA_ENCODER.IMAGE_BACKBONE": {
        **NORM,
        "DEPTH": COUNT.or_null(),
        "OUT_CHANNELS": COUNT,
        "STEM": COUNT,
        "STEM_KIND": TEXT,
        "BLOCK": TEXT,
        "BLOCKS": COUNT.list_of(),
        "WIDTHS": COUNT.list_of(),
        "PRETRAINED": TEXT.or_null(),
    },
    "CAMERA_ENCODER.CROP_TOP_PX": {"ego": COUNT_FROM_0, "infra": COUNT_FROM_0},
    "CAMERA_ENCODER.DEPTH": {
        **NORM,
        "MODE": TEXT,
        "NUM_BINS": COUNT,
        "RANGE_M.ego": POSITIVE.list_of(2),
        "RANGE_M.infra": POSITIVE.list_of(2),
        "MID_CHANNELS": COUNT,
        **{f"LOSS.{key}": FROM_0 for key in ("WEIGHT", "ALPHA", "GAMMA", "FG_WEIGHT", "BG_WEIGHT")},
        "LOSS.SOFT_TARGET": FLAG,
        "LOSS.FG_DISTANCE_M": POSITIVE.or_null(),
        "LOSS.FG_DISTANCE_RANGE": FROM_0.list_of(2),
        "LOSS.EXPECTATION_WEIGHT": FROM_0,
    },
    "CAMERA_ENCODER.MAP_TO_BEV": {"NAME": TEXT, "HEIGHTS": COUNT, "SAMPLING": TEXT},
    "CAMERA_ENCODER.ATTENTION": ATTENTION,
    "LIDAR_ENCODER.VFE": {
        **NORM,
        "NAME": TEXT,
        "NUM_FILTERS": COUNT.list_of(),
        "USE_ABSLOTE_XYZ": FLAG,
        "AS_OPENPCDET.LIDAR_HEIGHT_M": FROM_0,
        "AS_OPENPCDET.Z_RANGE_M": NUMBER.list_of(2),
        "AS_OPENPCDET.MAX_POINTS": COUNT,
    },
    "LIDAR_ENCODER.MAP_TO_BEV": {"NAME": TEXT},
    "LIDAR_ENCODER.ATTENTION": ATTENTION,
    "COMPRESSION": {**CODEC, **ON_THE_AIR},
    "FUSER": {"NAME": TEXT, "ORIGINAL_FORM": FLAG},
    "BACKBONE_2D": {
        **NORM,
        "NAME": TEXT,
        "LAYER_NUMS": COUNT_FROM_0.list_of(),
        "LAYER_STRIDES": COUNT.list_of(),
        "NUM_FILTERS": COUNT.list_of(),
        "UPSAMPLE_STRIDES": POSITIVE.list_of(),
        "NUM_UPSAMPLE_FILTERS": COUNT.list_of(),
        **{f"ATTENTION.{key}": rule for key, rule in ATTENTION.items()},
        **{f"COMPRESSION.{key}": rule for key, rule in CODEC.items()},
    },
    "DENSE_HEAD": {
        "NAME": TEXT,
        "USE_DIRECTION_CLASSIFIER": FLAG,
        "DIR_OFFSET": NUMBER,
        "NUM_DIR_BINS": COUNT,
        "ANCHOR_GENERATOR_CONFIG.*.class_name": TEXT,
        "ANCHOR_GENERATOR_CONFIG.*.anchor_sizes": POSITIVE.list_of(),
        "ANCHOR_GENERATOR_CONFIG.*.anchor_rotations": NUMBER.list_of(),
        "ANCHOR_GENERATOR_CONFIG.*.anchor_bottom_heights": NUMBER.list_of(),
        "ANCHOR_GENERATOR_CONFIG.*.align_center": FLAG,
        "ANCHOR_GENERATOR_CONFIG.*.feature_map_stride": COUNT,
        "ANCHOR_GENERATOR_CONFIG.*.matched_threshold": SHARE_ABOVE_0,
        "ANCHOR_GENERATOR_CONFIG.*.unmatched_threshold": SHARE_ABOVE_0,
        "ANCHOR_GENERATOR_CONFIG.*.heading_weight": FROM_0,
        "LOSS_CONFIG.LOSS_WEIGHTS.cls_weight": FROM_0,
        "LOSS_CONFIG.LOSS_WEIGHTS.loc_weight": FROM_0,
        "LOSS_CONFIG.LOSS_WEIGHTS.dir_weight": FROM_0,
        "LOSS_CONFIG.LOSS_WEIGHTS.code_weights": FROM_0.list_of(7),
    },
    "POST_PROCESSING": {
        "RECALL_THRESH_LIST": ANY,
        "SCORE_THRESH": SHARE.per_class(),
        "EVAL_METRIC": TEXT,
        "OUTPUT_RAW_SCORE": FLAG,
        "NMS_CONFIG.NMS_THRESH": SHARE.per_class(),
        "NMS_CONFIG.VOTE_IOU": SHARE.per_class(),
        "NMS_CONFIG.NMS_PRE_MAXSIZE": COUNT,
        "NMS_CONFIG.NMS_POST_MAXSIZE": COUNT,
    },
}
REGISTRATION = {
    "ENABLED": FLAG,
    "POSITION_STD_M": POSITIVE,
    "YAW_STD_DEG": POSITIVE,
    "MIN_GAIN": SHARE,
    "FRAMES": COUNT,
}
MODEL = {
    **NORM,
    "NAME": TEXT,
    "AGENTS": NAMES,
    "NUM_BEV_FEATURES": COUNT,
    "SHARE_ENCODERS": FLAG,
    "ROADSIDE_MAP_DROPOUT": SHARE,
    "ROADSIDE_SEGMENT_DROPOUT": SHARE,
    "IGNORE_CONFIG": NAMES,
    **{f"REGISTRATION.{key}": rule for key, rule in REGISTRATION.items()},
    **{f"{section}.{key}": rule for section, rules in SECTIONS.items() for key, rule in rules.items()},
}
OPTIMIZATION = {
    "BATCH_SIZE_PER_GPU": COUNT,
    "NUM_EPOCHS": COUNT,
    "OPTIMIZER": TEXT,
    "LR": POSITIVE,
    "LR_FACTORS": FACTORS,
    "WEIGHT_DECAY": FROM_0,
    "BETAS": BETWEEN.list_of(2),
    "MOMS": BETWEEN.list_of(2),
    "PCT_START": BETWEEN,
    "DIV_FACTOR": FROM_1,
    "GRAD_NORM_CLIP": POSITIVE,
    "USE_AMP": FLAG,
    "AMP_DTYPE": TEXT,
    "SENSOR_SETS": NAMES,
    # Read by OpenPCDet only:
    "MOMENTUM": NUMBER,
    "DECAY_STEP_LIST": ANY,
    "LR_DECAY": NUMBER,
    "LR_CLIP": NUMBER,
    "LR_WARMUP": FLAG,
    "WARMUP_EPOCH": COUNT_FROM_0,
}
PARTS = {"DATA_CONFIG": DATA, "MODEL": MODEL, "OPTIMIZATION": OPTIMIZATION}
RULES: dict[str, Rule] = {
    "CLASS_NAMES": NAMES,
    **{f"{part}.{key}": rule for part, rules in PARTS.items() for key, rule in rules.items()},
    **DATA,  # a file of DATA_CONFIG alone, for tools/create_data.py
}
# Mappings that are one value.
LEAVES = {
    "OPTIMIZATION.LR_FACTORS",
    "MODEL.POST_PROCESSING.SCORE_THRESH",
    "MODEL.POST_PROCESSING.NMS_CONFIG.NMS_THRESH",
    "MODEL.POST_PROCESSING.NMS_CONFIG.VOTE_IOU",
}
OUR_NAMES = {
    "MODEL": ("AvpCp", "CameraDepth"),
    "MODEL.CAMERA_ENCODER.MAP_TO_BEV": ("FrustumToBev",),
    "MODEL.LIDAR_ENCODER.VFE": ("DynamicPillars",),
    "MODEL.LIDAR_ENCODER.MAP_TO_BEV": ("PillarScatter",),
    "MODEL.COMPRESSION": ("BevCodec", "NoCompression"),
    "MODEL.FUSER": ("AdaFusion", "SpatialAdaFusion", "ChannelAdaFusion", "AverageFusion", "MaxFusion"),
    "MODEL.BACKBONE_2D": ("BaseBEVBackbone", "DeformableAttentionBackbone", "CompressedBackbone"),
    "MODEL.DENSE_HEAD": ("AnchorHeadSingle",),
}


def is_foreign(pattern: str, section: Mapping[str, Any]) -> bool:
    """Whether a section is for a class of the user's own, whose keys nobody else knows."""
    return pattern in OUR_NAMES and "NAME" in section and section["NAME"] not in OUR_NAMES[pattern]
