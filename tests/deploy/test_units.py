"""Maps of several roadside units in the exported vehicle: merged as the network in torch merges them."""

import numpy as np
import pytest
import torch

from pcdet_avp.deploy.halves import merged
from pcdet_avp.errors import LinkError
from pcdet_avp.link import MapStamp, decode, encode
from pcdet_avp.link.units import by_source
from pcdet_avp.models.fusion.units import strongest


def placed(count, seed=0):
    """Warped maps with many empty cells, and their masks; two are of equal lengths everywhere."""
    rng = np.random.default_rng(seed)
    maps = rng.normal(size=(count, 4, 6, 5)) * (rng.random((count, 1, 6, 5)) < 0.5)
    maps[-1] = -maps[0]
    masks = rng.random((count, 1, 6, 5)) < 0.7
    maps = np.where(masks, maps, 0).astype(np.float32)
    return [(maps[i : i + 1], masks[i : i + 1]) for i in range(count)]


@pytest.mark.parametrize("count", [2, 3])
def test_the_rule_is_torch_s(count):
    units = placed(count)
    X, present = merged(units)
    expected = strongest(*(torch.from_numpy(np.concatenate(parts)) for parts in zip(*units, strict=True)))
    np.testing.assert_array_equal(present[0], expected[1].numpy())
    np.testing.assert_array_equal(X[0], expected[0].numpy())


def test_one_unit_passes_as_it_is():
    (unit,) = placed(1)
    assert merged([unit]) is unit


def test_maps_are_sorted_by_source_and_number_and_a_unit_has_one_of_each():
    stamps = [MapStamp(1, 0, name, 0, 0, 0, sender) for sender, name in ((7, "lidar"), (2, "lidar"), (7, "camera"))]
    maps = [decode(encode(np.zeros((1, 2, 2), np.float32), stamp, 500)) for stamp in stamps]
    found = {source: [known.stamp.sender for known in units] for source, units in by_source(maps).items()}
    assert found == {"infra_camera": [7], "infra_lidar": [2, 7]}
    with pytest.raises(LinkError, match="unit 2: two lidar maps"):
        by_source([*maps, maps[1]])
