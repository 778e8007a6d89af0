"""Our fusers in the place of OpenPCDet's ConvFuser."""

import pytest
import torch
from easydict import EasyDict

from pcdet_avp.errors import GeometryError
from pcdet_avp.plugin import our_classes
from pcdet_avp.registry import FUSERS

TWO_MAP = our_classes()["pcdet.models.backbones_2d.fuser"]


def batch(image, lidar):
    return {"spatial_features_img": image, "spatial_features": lidar, "frame_id": "kept"}


@pytest.mark.parametrize("name", TWO_MAP)
def test_two_maps_fuse_as_a_vehicle_alone_fuses_its_own_two(name):
    """With the same weights; the vehicle's path is tested on its own."""
    torch.manual_seed(0)
    fuser, ours = TWO_MAP[name](model_cfg=EasyDict(OUT_CHANNEL=4)), FUSERS[name](EasyDict())
    ours.load_state_dict(fuser.state_dict())
    image, lidar = torch.rand(2, 4, 6, 5), torch.rand(2, 4, 6, 5)
    everywhere = torch.ones(2, 1, 6, 5).bool()
    valid = {"ego_camera": everywhere, "ego_lidar": everywhere}
    expected = ours({"bev_maps": {"ego_camera": image, "ego_lidar": lidar}, "bev_valid": valid})
    out = fuser(batch(image, lidar.clone()))
    assert out["frame_id"] == "kept"
    torch.testing.assert_close(out["spatial_features"], expected["spatial_features"])


def test_average_and_maximum_by_hand():
    image, lidar = torch.full((1, 2, 2, 2), 1.0), torch.full((1, 2, 2, 2), 3.0)
    for name, expected in (("AverageFusion", 2.0), ("MaxFusion", 3.0)):
        fused = TWO_MAP[name](model_cfg=EasyDict())(batch(image, lidar.clone()))["spatial_features"]
        assert fused.unique().tolist() == [expected]


def test_maps_of_different_shapes_are_refused():
    fuser = TWO_MAP["AdaFusion"](model_cfg=EasyDict())
    with pytest.raises(GeometryError, match=r"one shape, found \(1, 8, 4, 4\) and \(1, 4, 4, 4\)"):
        fuser(batch(torch.zeros(1, 8, 4, 4), torch.zeros(1, 4, 4, 4)))
