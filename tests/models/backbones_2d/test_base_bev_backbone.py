"""The BEV backbone: sizes, names and counts of OpenPCDet's PointPillars, independence of samples."""

import pytest
import torch
from easydict import EasyDict

from pcdet_avp.errors import ConfigError, GeometryError
from pcdet_avp.models.backbones_2d.base_bev_backbone import BaseBEVBackbone

KITTI = EasyDict(
    LAYER_NUMS=[3, 5, 5],
    LAYER_STRIDES=[2, 2, 2],
    NUM_FILTERS=[64, 128, 256],
    UPSAMPLE_STRIDES=[1, 2, 4],
    NUM_UPSAMPLE_FILTERS=[128, 128, 128],
    NORM="batch",
)


def small(**changes):
    cfg = dict(LAYER_NUMS=[1, 1], LAYER_STRIDES=[1, 2], NUM_FILTERS=[8, 16], UPSAMPLE_STRIDES=[1, 2])
    return BaseBEVBackbone(EasyDict(cfg, NUM_UPSAMPLE_FILTERS=[8, 8], **changes), 4)


def test_pointpillars_has_its_published_size_and_names():
    backbone = BaseBEVBackbone(KITTI, 64)
    state = backbone.state_dict()
    assert state["blocks.0.1.weight"].shape == (64, 64, 3, 3)
    assert state["blocks.2.16.weight"].shape == (256, 256, 3, 3)
    assert state["blocks.0.2.running_mean"].shape == (64,)
    assert state["deblocks.2.0.weight"].shape == (256, 128, 4, 4)
    # OpenPCDet's KITTI PointPillars has 4,834,888 parameters: 768 in the VFE (10 x 64 + 2 x 64), 72 channels out of
    # 384 in the head (18 scores, 42 box codes, 12 directions), the rest here.
    assert sum(p.numel() for p in backbone.parameters()) == 4_834_888 - 768 - (384 * 72 + 72)
    assert backbone.num_bev_features == 384
    assert backbone.output_stride == 2


@pytest.mark.parametrize(("first", "stride"), [(1, 1), (2, 2)])
def test_output_size_follows_the_first_stride(first, stride):
    backbone = small(LAYER_STRIDES=[first, 2])
    out = backbone({"spatial_features": torch.randn(2, 4, 12, 8), "other": 1})
    assert backbone.output_stride == stride
    assert out["spatial_features_2d"].shape == (2, 16, 12 // stride, 8 // stride)
    assert out["other"] == 1


def test_group_norm_keeps_samples_apart():
    torch.manual_seed(0)
    backbone, x = small(), torch.randn(3, 4, 8, 8)
    backbone.train()
    torch.testing.assert_close(backbone.encode(x)[1:2], backbone.encode(x[1:2]), atol=1e-6, rtol=1e-5)


def test_stages_may_end_below_the_input_of_the_first():
    backbone = small(UPSAMPLE_STRIDES=[0.5, 1])
    assert backbone.encode(torch.randn(1, 4, 8, 8)).shape == (1, 16, 4, 4)


def test_bad_keys_and_sizes_are_named():
    with pytest.raises(ConfigError, match="unequal strides"):
        small(UPSAMPLE_STRIDES=[1, 1])
    with pytest.raises(ConfigError, match="lengths"):
        small(LAYER_NUMS=[1])
    with pytest.raises(ConfigError, match="NORM"):
        small(NORM="instance")
    with pytest.raises(GeometryError, match="9 x 8"):
        small().encode(torch.randn(1, 4, 9, 8))
