"""Our classes against the written-down interface of OpenPCDet; no checkout is needed."""

import importlib.util
import inspect
import logging
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from easydict import EasyDict

from pcdet_avp.config import load_config
from pcdet_avp.models.compression import BevCodec, NoCompression
from pcdet_avp.openpcdet.config import openpcdet_config
from pcdet_avp.plugin import our_classes
from pcdet_avp.registry import DETECTORS, FUSERS

HERE = Path(__file__).parent
CFGS = HERE.parents[1] / "cfgs" / "avp"


def load_neighbour(name):
    spec = importlib.util.spec_from_file_location(name, HERE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


contract = load_neighbour("openpcdet_contract")
CLASSES = [(table, cls) for table, classes in our_classes().items() for cls in classes.values()]


def check_call(function, positional, keywords, bound=True):
    arguments = [None] * (positional + (0 if bound else 1))
    inspect.signature(function).bind(*arguments, **dict.fromkeys(keywords))


@pytest.fixture
def cfg(tiny_data):
    cfg = EasyDict(openpcdet_config(load_config(CFGS / "cp_tiny.yaml")))
    cfg.DATA_CONFIG.DATA_PATH = str(tiny_data)
    return cfg


@pytest.fixture
def openpcdet_data(cfg):
    """``openpcdet_data(training)``: our data set, built by OpenPCDet's call."""

    def build(training):
        cls = our_classes()["pcdet.datasets"]["AvpDataset"]
        arguments = {"dataset_cfg": cfg.DATA_CONFIG, "class_names": cfg.CLASS_NAMES, "root_path": None}
        return cls(**arguments, training=training, logger=logging.getLogger("openpcdet"))

    return build


def to_device(batch):
    """What OpenPCDet's load_data_to_gpu does, as the contract describes it."""
    loaded = {}
    for key, value in batch.items():
        if not isinstance(value, np.ndarray) or key in contract.SPARED_KEYS:
            loaded[key] = value
        else:
            assert key != "images", "OpenPCDet would need kornia"
            loaded[key] = torch.from_numpy(value).int() if key == "image_shape" else torch.from_numpy(value).float()
    return loaded


@pytest.mark.parametrize(("table", "cls"), CLASSES, ids=lambda value: getattr(value, "__name__", str(value)))
def test_every_registered_class_takes_openpcdets_constructor_call(table, cls):
    check_call(cls, 0, contract.CONSTRUCTORS[table])


def test_every_registered_class_can_be_found_by_its_name_in_another_process():
    """OpenPCDet's launchers start loader processes that unpickle classes by module and name."""
    for _, cls in CLASSES:
        assert pickle.loads(pickle.dumps(cls)) is cls


def test_the_data_set_has_the_methods_and_attributes_that_openpcdet_uses(openpcdet_data):
    dataset = openpcdet_data(training=False)
    for name, call in contract.DATASET_METHODS.items():
        check_call(getattr(dataset, name), *call)
    assert all(hasattr(dataset, name) for name in contract.DATASET_ATTRIBUTES)
    assert dataset.point_feature_encoder.num_point_features == 4
    assert dataset.grid_size.tolist() == [70, 94, 1]


def test_the_detector_has_the_methods_that_openpcdet_uses():
    cls = our_classes()["pcdet.models.detectors"]["AvpCp"]
    for name, call in contract.DETECTOR_METHODS.items():
        check_call(getattr(cls, name), *call, bound=False)


def test_one_step_and_one_evaluation_by_openpcdets_rules(openpcdet_data, cfg):
    training = openpcdet_data(training=True)
    cls = our_classes()["pcdet.models.detectors"]["AvpCp"]
    network = cls(model_cfg=cfg.MODEL, num_class=2, dataset=training)
    batch = to_device(training.collate_batch([training[0], training[1]]))
    losses, terms, shown = network.train()(batch)
    losses["loss"].mean().backward()
    network.update_global_step()
    assert isinstance(terms, dict)
    assert isinstance(shown, dict)
    test = openpcdet_data(training=False)
    annotations = []
    for i in range(len(test)):
        batch = to_device(test.collate_batch([test[i]]))
        with torch.no_grad():
            found, recall = network.eval()(batch)
        assert set(found[0]) >= contract.PREDICTION_KEYS
        assert {"gt", *(f"rcnn_{v}" for v in cfg.MODEL.POST_PROCESSING.RECALL_THRESH_LIST)} <= set(recall)
        annotations += test.generate_prediction_dicts(batch, found, test.class_names, output_path=None)
    pickle.dumps(annotations)
    assert all(len(annotation["name"]) == len(annotation["score"]) for annotation in annotations)
    text, numbers = test.evaluation(annotations, test.class_names, eval_metric="avp", output_path=None)
    assert text
    assert all(isinstance(value, float) for value in numbers.values())


def test_the_optimiser_sees_every_parameter_of_every_piece():
    cfg = EasyDict(
        LAYER_NUMS=[1],
        LAYER_STRIDES=[1],
        NUM_FILTERS=[8],
        UPSAMPLE_STRIDES=[1],
        NUM_UPSAMPLE_FILTERS=[8],
        ATTENTION={"HEADS": 2},
    )
    backbones = our_classes()["pcdet.models.backbones_2d"].values()
    pieces = [cls(model_cfg=cfg, input_channels=8) for cls in backbones]
    pieces += [cls(model_cfg=EasyDict()) for cls in our_classes()["pcdet.models.backbones_2d.fuser"].values()]
    pieces += [cls(EasyDict()) for cls in FUSERS.values()]
    pieces += [cls(EasyDict(REDUCTION=4), 8) for cls in (BevCodec, NoCompression)]
    for name in ("group", "batch"):
        pillars = our_classes()["pcdet.models.backbones_3d.vfe"]["DynamicPillars"]
        vfe_cfg = EasyDict(NUM_FILTERS=[8, 8], NORM=name)
        pieces.append(pillars(vfe_cfg, 4, point_cloud_range=[0, 0, 0, 4, 4, 4], voxel_size=[1, 1, 4]))
    for piece in pieces:
        seen = {id(p) for p in contract.leaf_parameters(piece)}
        missed = [name for name, p in piece.named_parameters() if id(p) not in seen]
        assert not missed, f"{type(piece).__name__}: {missed}"


@pytest.mark.parametrize("name", sorted(str(path.relative_to(CFGS)) for path in CFGS.rglob("*.yaml")))
def test_the_optimiser_sees_every_parameter_of_every_network(name):
    cfg = load_config(CFGS / name)
    encoder = EasyDict(num_point_features=4)
    geometry = {"point_cloud_range": cfg.DATA_CONFIG.POINT_CLOUD_RANGE, "voxel_size": cfg.DATA_CONFIG.VOXEL_SIZE}
    dataset = EasyDict(class_names=cfg.CLASS_NAMES, point_feature_encoder=encoder, **geometry)
    with torch.device("meta"):
        network = DETECTORS[cfg.MODEL.NAME](cfg.MODEL, 2, dataset)
    seen = {id(p) for p in contract.leaf_parameters(network)}
    missed = [name for name, p in network.named_parameters() if id(p) not in seen]
    assert not missed, missed
