"""Our data set, network and metric in mmengine's registries, for its Runner and so for mmdetection3d's users.

Importing this module registers them; in a configuration of mmengine:

    custom_imports = dict(imports=["pcdet_avp.mmengine_plugin"])
    model = dict(type="AvpCp", cfg="cfgs/avp/cp_small.yaml")
    train_dataloader = dict(batch_size=2, num_workers=2, sampler=dict(type="DefaultSampler", shuffle=True),
                            collate_fn=dict(type="avp_collate"),
                            dataset=dict(type="AvpDataset", cfg="cfgs/avp/cp_small.yaml", training=True))
    val_evaluator = dict(type="AvpMetric", cfg="cfgs/avp/cp_small.yaml")

``cfg`` is a configuration of ours; mmengine's own schedules, hooks and launchers do the rest. Weights of our own tools
are the model's ``ckpt``: mmengine's ``load_from`` and ``resume`` are for what its Runner saved.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from typing import Any

from mmengine.evaluator import BaseMetric
from mmengine.model import BaseModel
from mmengine.registry import DATASETS, FUNCTIONS, METRICS, MODELS

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.errors import CheckpointError, ConfigError
from pcdet_avp.models.weights.meaning import differences, meaning_of, some_of
from pcdet_avp.openpcdet.dataset import OpenPCDetAvpDataset
from pcdet_avp.openpcdet.detector import OpenPCDetAvpCp
from pcdet_avp.shipped import find_checkpoint
from pcdet_avp.structures.sensor_set import SENSOR_SETS

MADE_FOR = "made_for"  # of a sample: what its data mean (``_meaning_of_data``), which the network compares


@DATASETS.register_module(name="AvpDataset")
class MmAvpDataset(OpenPCDetAvpDataset):
    """Frames of the configuration's split; training draws one of ``sensor_sets`` for every sample."""

    def __init__(
        self,
        cfg: str,
        training: bool = False,
        data_path: str | None = None,
        sensor_sets: Sequence[str] = tuple(SENSOR_SETS),
        sensor_set: str | None = None,
    ) -> None:
        """``sensor_set`` is what a test uses, by default the configuration's SENSOR_SET."""
        ours = load_config(cfg)
        data_cfg = ours.DATA_CONFIG
        if isinstance(sensor_sets, str):
            raise ConfigError(f"AvpDataset: sensor_sets: expected a list of combinations, found {sensor_sets!r}")
        data_cfg.update(TRAIN_SENSOR_SETS=list(sensor_sets), SENSOR_SET=sensor_set or data_cfg.SENSOR_SET)
        data_cfg.DATA_PATH = data_path or data_cfg.DATA_PATH
        super().__init__(data_cfg, ours.CLASS_NAMES, training)
        self._made_for = _meaning_of_data(ours)

    def __getitem__(self, key: int | tuple) -> dict:
        return {**super().__getitem__(key), MADE_FOR: self._made_for}


def _meaning_of_data(cfg: Mapping) -> str:
    """Classes, sensors and map of a configuration as JSON."""
    return json.dumps(meaning_of({key: cfg[key] for key in ("CLASS_NAMES", "DATA_CONFIG")}))


@FUNCTIONS.register_module()
def avp_collate(samples: Sequence[dict]) -> dict:
    """The keyword arguments of the network's ``forward``."""
    return {"inputs": OpenPCDetAvpDataset.collate_batch(samples)}


@MODELS.register_module(name="AvpCp")
class MmAvpCp(BaseModel):
    """``AvpCp`` as a model of mmengine."""

    def __init__(self, cfg: str, ckpt: str | None = None, data_preprocessor: dict | None = None) -> None:
        """``ckpt``: start from the weights in a checkpoint of ours, which must mean what ``cfg`` says."""
        super().__init__(data_preprocessor)
        ours = load_config(cfg)
        self.class_names = list(ours.CLASS_NAMES)
        self._made_for = _meaning_of_data(ours)
        network_input = NetworkInput.from_config(ours.DATA_CONFIG, self.class_names)
        self.network = OpenPCDetAvpCp(ours.MODEL, len(self.class_names), network_input)
        if ckpt is not None:
            self.network.load_params_from_file(find_checkpoint(ckpt), logging.getLogger(__name__), to_cpu=True)

    def forward(self, inputs: dict, mode: str = "predict") -> dict | list[dict]:
        """inputs: a collated batch. ``loss``: {"loss": scalar} and what it is made of; ``predict``: annotations.

        ConfigError for another mode, for ``loss`` of a network in ``eval`` or ``predict`` of one in ``train``, and for
        data of another configuration than the network's.
        """
        if mode != ("loss" if self.training else "predict"):
            raise ConfigError(
                f"AvpCp: expected mode 'loss' in training and 'predict' in eval, found {mode!r} in "
                + ("training" if self.training else "eval")
            )
        self._check_data(inputs)
        batch_dict = load_batch(inputs, self.network.global_step.device)
        if mode != "loss":
            predictions, _ = self.network(batch_dict)
            return OpenPCDetAvpDataset.generate_prediction_dicts(batch_dict, predictions, self.class_names)
        losses, terms, _ = self.network(batch_dict)
        self.network.update_global_step()
        # mmengine adds up whatever has "loss" in its name
        return losses | {key.replace("loss", "part"): value.detach() for key, value in terms.items()}

    def _check_data(self, inputs: Mapping[str, Any]) -> None:
        for made_for in {*map(str, inputs.get(MADE_FOR, ()))} - {self._made_for}:
            if found := differences(json.loads(made_for), json.loads(self._made_for)):
                told = some_of(found).replace("in the file", "in the data set's cfg").replace("here", "in the model's")
                raise ConfigError(f"AvpCp: data and network have different configurations: {told}")

    def _load_from_state_dict(self, state_dict: Mapping[str, Any], prefix: str, *args: Any) -> None:
        """CheckpointError for a file with nothing of this network, which mmengine would pass over with a warning."""
        if not any(name.startswith(f"{prefix}network.") for name in state_dict):
            found = ", ".join(list(state_dict)[:3]) or "nothing"
            raise CheckpointError(
                f"AvpCp: expected a checkpoint of mmengine's Runner with tensors network.*, found {found}; weights of "
                "pcdet_avp's own tools are the model's: model=dict(type='AvpCp', cfg=..., ckpt=FILE)"
            )
        super()._load_from_state_dict(state_dict, prefix, *args)


@METRICS.register_module(name="AvpMetric")
class AvpMetric(BaseMetric):
    """Average precision over the split that the configuration tests on."""

    default_prefix = "avp"

    def __init__(self, cfg: str, data_path: str | None = None, **base) -> None:
        super().__init__(**base)
        self.dataset = MmAvpDataset(cfg, training=False, data_path=data_path)

    def process(self, data_batch: dict, data_samples: Sequence[dict]) -> None:
        """Keep the annotations of a batch."""
        self.results.extend(data_samples)

    def compute_metrics(self, results: list[dict]) -> dict[str, float]:
        """Numbers by name, in percent."""
        _, numbers = self.dataset.evaluation(results, self.dataset.class_names)
        return numbers
