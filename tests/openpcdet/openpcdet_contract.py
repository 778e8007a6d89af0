"""OpenPCDet's side of the seam, written down: how it calls a registered class and what it reads from it.

``test_contract.py`` holds our classes against this page every day, ``test_openpcdet.py`` holds this page
against a real checkout on demand. As of commit 8caccce (2024-04-17).
"""

# Table -> keywords of the one call that OpenPCDet makes to a class from it.
CONSTRUCTORS = {
    "pcdet.datasets": {"dataset_cfg", "class_names", "root_path", "training", "logger"},
    "pcdet.models.detectors": {"model_cfg", "num_class", "dataset"},
    "pcdet.models.backbones_3d.vfe": {
        "model_cfg",
        "num_point_features",
        "point_cloud_range",
        "voxel_size",
        "grid_size",
        "depth_downsample_factor",
    },
    "pcdet.models.backbones_2d.map_to_bev": {"model_cfg", "grid_size"},
    "pcdet.models.backbones_2d.fuser": {"model_cfg"},
    "pcdet.models.backbones_2d": {"model_cfg", "input_channels"},
}
# File of OpenPCDet and the name by which the call there finds the table.
CALL_SITES = {
    "pcdet.datasets": ("pcdet/datasets/__init__.py", "__all__"),
    "pcdet.models.detectors": ("pcdet/models/detectors/__init__.py", "__all__"),
    "pcdet.models.backbones_3d.vfe": ("pcdet/models/detectors/detector3d_template.py", "vfe"),
    "pcdet.models.backbones_2d.map_to_bev": ("pcdet/models/detectors/detector3d_template.py", "map_to_bev"),
    "pcdet.models.backbones_2d.fuser": ("pcdet/models/detectors/bevfusion.py", "fuser"),
    "pcdet.models.backbones_2d": ("pcdet/models/detectors/detector3d_template.py", "backbones_2d"),
}
# What OpenPCDet reads from a data set that it has built.
DATASET_ATTRIBUTES = {
    "class_names",
    "point_feature_encoder",
    "grid_size",
    "point_cloud_range",
    "voxel_size",
    "depth_downsample_factor",
}
# Methods, with the positional arguments and keywords of OpenPCDet's calls.
DATASET_METHODS = {
    "collate_batch": (1, set()),
    "generate_prediction_dicts": (3, {"output_path"}),
    "evaluation": (2, {"eval_metric", "output_path"}),
    "__len__": (0, set()),
    "__getitem__": (1, set()),
}
DETECTOR_METHODS = {
    "forward": (1, set()),
    "update_global_step": (0, set()),
    "load_params_from_file": (0, {"filename", "logger", "to_cpu", "pre_trained_path"}),
    "load_params_with_optimizer": (1, {"to_cpu", "optimizer", "logger"}),
}
# Keys of a batch that load_data_to_gpu leaves alone. ``images`` goes through kornia, ``image_shape`` becomes int,
# every other array becomes float32 (text raises), and what is no array stays where it is.
SPARED_KEYS = {"frame_id", "metadata", "calib", "image_paths", "ori_shape", "img_process_infos"}
# Read from OPTIMIZATION with adam_onecycle, from DATA_CONFIG and from MODEL.POST_PROCESSING.
OPTIMIZATION_KEYS = {
    "BATCH_SIZE_PER_GPU",
    "NUM_EPOCHS",
    "OPTIMIZER",
    "LR",
    "WEIGHT_DECAY",
    "MOMS",
    "PCT_START",
    "DIV_FACTOR",
    "DECAY_STEP_LIST",
    "LR_DECAY",
    "LR_CLIP",
    "GRAD_NORM_CLIP",
}
PREDICTION_KEYS = {"pred_boxes", "pred_scores", "pred_labels"}


def leaf_parameters(module):
    """The parameters that OpenPCDet's optimiser gets: it flattens a network to modules without children."""
    children = list(module.children())
    leaves = [leaf for child in children for leaf in leaf_parameters(child)]
    return leaves if children else list(module.parameters())
