"""Our detector as one of OpenPCDet's several processes, which expects a gradient from every parameter."""

from pathlib import Path

import pytest
import torch
import torch.distributed as dist
from torch.nn.parallel import DistributedDataParallel

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.models.detectors.avp_cp import AvpCp
from pcdet_avp.openpcdet.dataset import OpenPCDetAvpDataset
from pcdet_avp.openpcdet.detector import OpenPCDetAvpCp

CFG = Path(__file__).parents[2] / "cfgs" / "avp" / "cp_tiny.yaml"


@pytest.fixture
def process_group(tmp_path):
    """A group of one process: DistributedDataParallel does what it does among many."""
    dist.init_process_group("gloo", init_method=f"file://{tmp_path}/store", rank=0, world_size=1)
    yield
    dist.destroy_process_group()


@pytest.fixture
def build(tiny_data):
    def build(cls):
        """The detector, and a batch without LiDARs and roadside."""
        cfg = load_config(CFG)
        cfg.DATA_CONFIG.update(DATA_PATH=str(tiny_data), SENSOR_SET="C+none")
        dataset = OpenPCDetAvpDataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=True)
        torch.manual_seed(0)
        batch = load_batch(dataset.collate_batch([dataset[0]]), "cpu")
        batch["images"] = batch["images_ego"]
        return cls(cfg.MODEL, 2, dataset), batch

    return build


def steps(network, batch, count=2):
    parallel = DistributedDataParallel(network)
    for _ in range(count):
        parallel.zero_grad()
        parallel(dict(batch))[0]["loss"].backward()


def test_without_lidar_openpcdets_processes_go_on(process_group, build):
    network, batch = build(OpenPCDetAvpCp)
    steps(network, batch)
    absent = network.encoders["ego_lidar"].vfe.pfn_layers[0].linear.weight.grad
    assert absent is not None
    assert not absent.any()
    assert any(p.grad.any() for p in network.encoders["ego_camera"].parameters())


def test_ours_as_it_is_would_stop_them(process_group, build):
    with pytest.raises(RuntimeError, match="Expected to have finished reduction"):
        steps(*build(AvpCp))


def test_alone_an_absent_sensor_has_no_gradient_at_all(build):
    network, batch = build(OpenPCDetAvpCp)
    network.train()(batch)[0]["loss"].backward()
    assert network.encoders["ego_lidar"].vfe.pfn_layers[0].linear.weight.grad is None
