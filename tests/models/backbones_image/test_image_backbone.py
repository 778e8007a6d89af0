"""The residual networks: torchvision's names and sizes, weights from a file, stride 4."""

import pytest
import torch
from easydict import EasyDict
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_image.image_backbone import ImageBackbone, load_imagenet_weights
from pcdet_avp.models.backbones_image.resnet import DEPTHS, PatchStem, ResNet

# Parameters of torchvision's networks without the classifier (fc): 11,689,512 - 513,000 and so on.
PARAMETERS = {18: 11_176_512, 34: 21_284_672, 50: 23_508_032}


def resnet(depth=18, norm="batch"):
    blocks, block = DEPTHS[depth]
    return ResNet(blocks, (64, 128, 256, 512), block, norm)


def light(norm="group", **settings):
    sizes = {"BLOCKS": [1, 1, 1], "WIDTHS": [8, 16, 24], "STEM": 8, "OUT_CHANNELS": 16}
    return ImageBackbone(EasyDict(**sizes, NORM=norm, **settings))


def imagenet_file(path, depth=18):
    """A file like torchvision's: batch norms with bookkeeping, and a classifier."""
    torch.manual_seed(5)
    state = {key: torch.rand_like(value, dtype=torch.float32) for key, value in resnet(depth).state_dict().items()}
    torch.save({**state, "fc.weight": torch.rand(1000, 512), "fc.bias": torch.rand(1000)}, path)
    return state


@pytest.mark.parametrize("depth", [18, 34, 50])
def test_parameter_counts_are_torchvisions(depth):
    with torch.device("meta"):
        assert sum(p.numel() for p in resnet(depth).parameters()) == PARAMETERS[depth]


def test_names_are_torchvisions():
    with torch.device("meta"):
        keys = set(resnet(50).state_dict())
    wanted = "conv1.weight bn1.running_var layer1.0.conv3.weight layer1.0.downsample.0.weight layer4.2.bn3.bias"
    assert set(wanted.split()) <= keys
    assert "layer1.1.downsample.0.weight" not in keys


@pytest.mark.parametrize("stem", ["conv", "patches"])
@pytest.mark.parametrize(
    ("size", "expected"), [((540, 960), (135, 240)), ((270, 480), (68, 120)), ((50, 37), (13, 10))]
)
def test_output_has_stride_four_rounded_up(size, expected, stem):
    with torch.no_grad():
        assert light(STEM_KIND=stem)(torch.rand(1, 3, *size)).shape == (1, 16, *expected)


def test_a_stem_of_patches_is_a_convolution_of_three_patches_width():
    """Kernel 12 x 12, stride 4: channel c * 16 + 4 * row + column of a patch is its pixel (row, column)."""
    torch.manual_seed(0)
    stem, images = PatchStem(8, "group"), torch.randn(2, 3, 24, 36)
    kernel = stem.conv.weight.view(8, 3, 4, 4, 3, 3).permute(0, 1, 4, 2, 5, 3).reshape(8, 3, 12, 12)
    expected = F.relu(stem.norm(F.conv2d(images, kernel, stride=4, padding=4)))
    torch.testing.assert_close(stem(images), expected, atol=1e-5, rtol=1e-5)


def test_an_unknown_stem_is_refused():
    with pytest.raises(ConfigError, match="STEM_KIND: expected one of conv, patches, found 'patch'"):
        light(STEM_KIND="patch")


def test_frozen_weights_load_and_nothing_but_the_classifier_is_left(tmp_path):
    state = imagenet_file(tmp_path / "r18.pth")
    network = resnet(norm="frozen_batch")
    unused = load_imagenet_weights(network, tmp_path / "r18.pth")
    assert torch.equal(network.layer3[1].bn2.running_var, state["layer3.1.bn2.running_var"])
    assert torch.equal(network.layer4[0].conv1.weight, state["layer4.0.conv1.weight"])
    assert {key.split(".")[-1] for key in unused if not key.startswith("fc")} == {"num_batches_tracked"}


def test_batch_norms_do_not_slip_into_group_norms(tmp_path):
    state = imagenet_file(tmp_path / "r18.pth")
    network = resnet(norm="group")
    unused = load_imagenet_weights(network, tmp_path / "r18.pth")
    assert torch.equal(network.conv1.weight, state["conv1.weight"])
    assert network.bn1.weight.eq(1).all()
    assert {"bn1.weight", "layer2.0.downsample.1.bias"} <= set(unused)


def test_weights_of_another_network_are_refused(tmp_path):
    imagenet_file(tmp_path / "r18.pth")
    with pytest.raises(ConfigError, match="lacks"):
        load_imagenet_weights(resnet(34, "frozen_batch"), tmp_path / "r18.pth")
    with pytest.raises(ConfigError, match=r"layer1\.0\.conv1\.weight has shape"):
        load_imagenet_weights(resnet(50, "frozen_batch"), tmp_path / "r18.pth")
    (tmp_path / "cut.pth").write_bytes((tmp_path / "r18.pth").read_bytes()[:1000])
    with pytest.raises(ConfigError, match=r"cut.pth: cannot be read"):
        load_imagenet_weights(resnet(), tmp_path / "cut.pth")
    with pytest.raises(ConfigError, match=r"missing\.pth"):
        ImageBackbone(
            EasyDict(DEPTH=18, OUT_CHANNELS=16, NORM="frozen_batch", PRETRAINED=str(tmp_path / "missing.pth"))
        )


def test_bad_configurations_are_refused():
    with pytest.raises(ConfigError, match=r"\[18, 34, 50\], found 101"):
        ImageBackbone(EasyDict(DEPTH=101, OUT_CHANNELS=16))
    with pytest.raises(ConfigError, match="1 to 4 stages"):
        ImageBackbone(EasyDict(BLOCKS=[1, 1], WIDTHS=[8], STEM=8, OUT_CHANNELS=16))


def test_every_stage_speaks_and_group_norm_keeps_samples_apart():
    network, images = light(), torch.rand(2, 3, 40, 64)
    features = network(images)
    torch.testing.assert_close(network(images[1:])[0], features[1], atol=1e-5, rtol=1e-5)
    features.square().sum().backward()
    assert all(p.grad.abs().sum() > 0 for p in network.parameters())
