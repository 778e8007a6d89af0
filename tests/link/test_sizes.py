"""Bytes of full-size maps, everything counted, against the paper's numbers and the obvious ways to write a map."""

import importlib.util
import zlib
from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.config import load_config
from pcdet_avp.link import MapStamp, NrV2xConfig, decode, encode, rounded

ROOT = Path(__file__).parents[2]
STAMP = MapStamp(1, 50_000, "lidar", 0.0, 0.0, 0.0)
FLOAT16_LIMIT_BYTES = 72_000


@pytest.fixture(scope="module")
def latent_maps():
    spec = importlib.util.spec_from_file_location("latent_maps", ROOT / "benchmarks" / "latent_maps.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def latent(latent_maps):
    cfg = load_config(ROOT / "cfgs" / "dataset_configs" / "avp_full.yaml")
    (latent,) = latent_maps.drawn_maps(cfg, scenes=1)["lidar"]
    assert latent.astype(np.float16).nbytes == 421_120  # the paper's dense map
    return latent


def size_of(latent, precision="float16", mcs=21):
    payloads = encode(latent, STAMP, NrV2xConfig(mcs=mcs).max_segment_bytes, precision)
    np.testing.assert_array_equal(decode(payloads).values, rounded(latent, precision))
    return sum(map(len, payloads))


@pytest.mark.parametrize("structure", ["cells", "elements"])
@pytest.mark.parametrize("sparsity", [0.82, 0.88])
@pytest.mark.parametrize("mcs", [7, 21])
def test_a_full_size_map_fits_the_papers_bytes_with_everything_counted(latent_maps, latent, structure, sparsity, mcs):
    sparse = latent_maps.sparsified(latent, sparsity, structure)
    assert (sparse != 0).mean() == pytest.approx(1 - sparsity, abs=0.001)
    assert size_of(sparse, "float16", mcs) <= FLOAT16_LIMIT_BYTES
    assert size_of(sparse, "int8", mcs) <= FLOAT16_LIMIT_BYTES / 2


def test_smaller_than_the_obvious_ways(latent_maps, latent):
    """Per-cell bitmap with plain vectors, and zlib of the dense map, neither with any header or segments."""
    sparse = latent_maps.sparsified(latent, 0.85, "cells")
    half, occupied = sparse.astype(np.float16), sparse.any(0)
    bitmap = occupied.size // 8 + half[:, occupied].nbytes
    assert size_of(sparse) < 0.8 * min(bitmap, len(zlib.compress(half.tobytes())))


@pytest.mark.parametrize(("kept", "sparsity"), [("cells", 0.82), ("elements", 0.88)])
def test_even_noise_without_any_structure_stays_near_its_entropy(kept, sparsity):
    """Independent occupancy and normal values: mask and values within an eighth of Shannon's bound."""
    rng = np.random.default_rng(0)
    latent = rng.normal(size=(8, 188, 140))
    latent *= rng.random((188, 140) if kept == "cells" else latent.shape) > sparsity
    p, sites = 1 - sparsity, 188 * 140 * (1 if kept == "cells" else 8)
    mask_bits = -sites * (p * np.log2(p) + (1 - p) * np.log2(1 - p))
    values = latent[latent != 0].astype(np.float16)
    octaves = np.bincount(values.view(np.uint16) >> 10 & 31) / len(values)
    octaves = octaves[octaves > 0]
    value_bits = len(values) * (1 + 10 - (octaves * np.log2(octaves)).sum())
    bound = (mask_bits + value_bits) / 8
    assert bound < size_of(latent) < 1.12 * bound
