"""The layout of a convolution's input: never its values, and plain only where a backward pass on AVX2 is to come."""

import pytest
import torch

from pcdet_avp.models.memory_layout import for_convolutions


@pytest.mark.parametrize(
    ("cpu", "training", "channels_last"),
    [("AVX512", True, True), ("AVX512", False, True), ("AVX2", True, False), ("AVX2", False, True)],
)
def test_the_layout_follows_the_processor_and_the_purpose(monkeypatch, cpu, training, channels_last):
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: cpu)
    x = torch.randn(2, 3, 4, 5)
    for given in (x, x.contiguous(memory_format=torch.channels_last)):
        with torch.set_grad_enabled(training):
            y = for_convolutions(given)
        assert torch.equal(x, y)
        layout = torch.channels_last if channels_last else torch.contiguous_format
        assert y.is_contiguous(memory_format=layout)
