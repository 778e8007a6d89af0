"""The data set under OpenPCDet's loader."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from torch.utils.data import DataLoader

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.errors import RecordError, SensorError
from pcdet_avp.openpcdet.dataset import OpenPCDetAvpDataset, find_data
from pcdet_avp.structures.sensor_set import SENSOR_SETS

CFG = Path(__file__).parents[2] / "cfgs" / "dataset_configs" / "avp_tiny.yaml"
NAMES = ["Car", "Pedestrian"]


@pytest.fixture
def build(tiny_data):
    def build(training=True, **changes):
        cfg = load_config(CFG)
        cfg.update({"DATA_PATH": str(tiny_data), **changes})
        return OpenPCDetAvpDataset(dataset_cfg=cfg, class_names=NAMES, root_path=None, training=training, logger=None)

    return build


def test_relative_data_are_found_below_either_place_and_the_first_wins(tiny_data, tmp_path):
    places = [tmp_path, tiny_data.parent]
    assert find_data(tiny_data.name, places) == tiny_data.resolve()
    nearer = tmp_path / tiny_data.name
    nearer.mkdir()
    (nearer / "dataset.json").touch()
    assert find_data(tiny_data.name, places) == nearer.resolve()
    assert find_data(str(tiny_data), [tmp_path]) == tiny_data.resolve()


def test_data_that_are_nowhere_are_an_error_that_lists_where_it_looked(tmp_path):
    with pytest.raises(RecordError, match=r"DATA_PATH data/x: .*a/data/x/dataset\.json or .*b/data/x/dataset\.json"):
        find_data("data/x", [tmp_path / "a", tmp_path / "b"])


def test_training_draws_a_combination_for_each_visit(build):
    dataset = build(TRAIN_SENSOR_SETS=["C+none", "CL+CL"])
    drawn = Counter(tuple(dataset[0]["source_present"].tolist()) for _ in range(20))
    assert set(drawn) == {SENSOR_SETS["C+none"].mask, SENSOR_SETS["CL+CL"].mask}
    assert min(drawn.values()) >= 4
    again = build(TRAIN_SENSOR_SETS=["C+none", "CL+CL"])
    repeated = [tuple(again[0]["source_present"].tolist()) for _ in range(20)]
    assert Counter(repeated) == drawn


def test_a_test_uses_the_one_that_the_configuration_names(build):
    dataset = build(training=False, TRAIN_SENSOR_SETS=["C+none"], SENSOR_SET="CL+C")
    assert tuple(dataset[0]["source_present"].tolist()) == SENSOR_SETS["CL+C"].mask


def test_an_unknown_combination_is_refused_at_once(build):
    with pytest.raises(SensorError, match="L\\+none"):
        build(TRAIN_SENSOR_SETS=["L+none"])


def test_the_egos_images_travel_channels_first_under_a_name_of_their_own(build):
    dataset = build(training=False)
    samples = [dataset[0], dataset[0, "C+C"]]
    batch, ours = dataset.collate_batch(samples), AvpDataset.collate_batch(samples)
    assert "images" not in batch
    assert np.array_equal(batch["images_ego"], ours["images"].transpose(0, 3, 1, 2))
    assert batch["images_ego"].shape == batch["images_infra"].shape


@pytest.mark.slow
def test_a_spawned_worker_loads_the_data_set(build):
    """OpenPCDet's distributed launchers switch to spawned processes."""
    dataset = build(training=False)
    arguments = {"num_workers": 1, "collate_fn": dataset.collate_batch, "multiprocessing_context": "spawn"}
    batches = list(DataLoader(dataset, batch_size=2, **arguments))
    assert sum(batch["batch_size"] for batch in batches) == len(dataset)
