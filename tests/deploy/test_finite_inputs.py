"""What is not a number is refused before a graph, because runtimes hide it (findings/openvino_nan.sh)."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.deploy.halves import Graphs
from pcdet_avp.errors import SensorError


class Relu:
    """A runtime whose every graph is OpenVINO's ReLU: zero for NaN."""

    def load(self, content, what):
        return lambda inputs: {"bev_map": np.fmax(inputs["image"], 0)}


@pytest.fixture
def graphs():
    return Graphs(SimpleNamespace(folder=Path("exported"), graph=lambda file: b""), Relu(), "vehicle")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_input_that_is_not_finite_is_refused_by_name(graphs, value):
    image = np.ones((1, 3, 4, 5), np.float32)
    image[0, 1, 2] = value
    with pytest.raises(SensorError, match=r"vehicle/camera\.onnx: image: .*found 5 of 60 that are NaN or infinite"):
        graphs("camera", image=image, cells=np.zeros(3, np.int64))


def test_finite_inputs_and_whole_numbers_pass(graphs):
    out = graphs("camera", image=np.full((1, 3, 4, 5), -2, np.float32), cells=np.full(3, 2**31))
    assert not out["bev_map"].any()
