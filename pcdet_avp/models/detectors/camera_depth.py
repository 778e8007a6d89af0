"""The depth branch of the camera encoders alone, to be trained without any BEV map (CaDDN, section 3.2).

Depth limits what cameras detect, and its branch costs a fifth of a whole training iteration. The names in its state
dict are those of ``AvpCp``, which takes a checkpoint of it by ``--pretrained_model``, and the other way round.
"""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

from pcdet_avp.config import require
from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_image.depth_loss import expected_depth
from pcdet_avp.models.detectors.build import with_norm
from pcdet_avp.models.detectors.loadable import LoadableDetector
from pcdet_avp.models.encoders.depth_branch import DepthBranch
from pcdet_avp.models.encoders.encoder import present_rows
from pcdet_avp.models.weights.agreement import NetworkMeaning
from pcdet_avp.models.weights.meaning import CODE_KEY
from pcdet_avp.registry import DETECTORS
from pcdet_avp.structures.sensor_set import agent_of

AGENTS = ("ego", "infra")
# All that the depth branch depends on.
MEANING_SECTIONS = (
    CODE_KEY,
    "DATA_CONFIG.IMAGE_SHAPE",
    "DATA_CONFIG.SENSORS.EGO.CAMERA",
    "DATA_CONFIG.SENSORS.INFRA.CAMERA",
    "MODEL.CAMERA_ENCODER.CROP_TOP_PX",
    "MODEL.CAMERA_ENCODER.DEPTH",
    "MODEL.CAMERA_ENCODER.IMAGE_BACKBONE",
)


class DepthEncoder(DepthBranch):
    """A camera encoder up to its depth distribution."""

    def __init__(self, model_cfg: Any) -> None:
        super().__init__()
        self.add_depth_branch(model_cfg)


@DETECTORS.register("CameraDepth")
class CameraDepth(LoadableDetector):
    """The camera encoders of MODEL.AGENTS (default: ego and infra), without their way to the BEV map."""

    detects_objects = False  # its result is a depth table, not average precision

    def __init__(self, model_cfg: Any, num_class: int, dataset: Any) -> None:
        """``num_class`` and ``dataset`` belong to the interface and change nothing."""
        super().__init__()
        cfg = with_norm(model_cfg)
        self.sources = tuple(f"{agent}_camera" for agent in _agents(cfg))  # all that it reads
        names = ("camera",) if cfg.get("SHARE_ENCODERS", False) else self.sources
        encoder_cfg = require(cfg, "CAMERA_ENCODER", dict)
        self.encoders = nn.ModuleDict({name: DepthEncoder(encoder_cfg) for name in names})
        self.add_global_step()
        self.meaning = NetworkMeaning.of(model_cfg, dataset, MEANING_SECTIONS)

    def encoder_of(self, source: str) -> DepthEncoder:
        """The encoder of a camera: its own, or the one that both agents share."""
        return self.encoders[source if source in self.encoders else "camera"]

    def forward(self, batch_dict: dict) -> tuple:
        """
        Args: batch_dict: what the data set collates, as tensors (see ``datasets.avp.prepare``)
        Returns:
            training: ({"loss": scalar}, tb_dict of scalars, disp_dict)
            evaluation: ({source: expected depth (R, h / 4, w / 4) in metres of the samples that have it}, {})
        """
        logits = self.depth_logits(batch_dict)
        if not self.training:
            bins = {source: self.encoder_of(source).bins[agent_of(source)] for source in logits}
            return {source: expected_depth(of_source, bins[source]) for source, of_source in logits.items()}, {}
        batch_dict = {**batch_dict, "depth_logits": logits}
        total, terms = 0.0, {}
        for source in self.sources:
            loss, of_source = self.encoder_of(source).get_loss(batch_dict, source)
            total, terms = total + loss, terms | of_source
        return {"loss": total}, terms | {"loss": total.detach()}, {}

    def depth_logits(self, batch_dict: dict) -> dict[str, Tensor]:
        """By camera: logits (R, NUM_BINS + 1, h / 4, w / 4) of the samples that have it, where there is any."""
        rows = {source: present_rows(batch_dict, source) for source in self.sources}
        return {
            source: self.encoder_of(source).features_and_logits(batch_dict, source, present)[1]
            for source, present in rows.items()
            if len(present)
        }


def _agents(cfg: Any) -> list[str]:
    agents = cfg.get("AGENTS", list(AGENTS))
    if not isinstance(agents, list) or not agents or not set(agents) <= set(AGENTS) or len(set(agents)) != len(agents):
        raise ConfigError(f"MODEL.AGENTS: expected one or both of {', '.join(AGENTS)}, found {agents}")
    return [agent for agent in AGENTS if agent in agents]
