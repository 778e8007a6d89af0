"""The paper's network: encoders, the roadside's maps on the air, warp, fusion, backbone, head (figure 2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial, reduce
from typing import Any

import torch
from torch import Tensor, nn

from pcdet_avp.config import require
from pcdet_avp.errors import ConfigError, SensorError
from pcdet_avp.models.compression.bev_codec import Latent
from pcdet_avp.models.detectors.build import build_modules
from pcdet_avp.models.detectors.loadable import LoadableDetector
from pcdet_avp.models.detectors.map_dropout import drop_roadside_maps, drop_segments
from pcdet_avp.models.detectors.post_processing import PostProcessing
from pcdet_avp.models.fusion.register import RegisterMaps
from pcdet_avp.models.fusion.units import merge_units
from pcdet_avp.models.precision import computing_in
from pcdet_avp.models.recompute import recomputed
from pcdet_avp.models.side_by_side import pays, side_by_side
from pcdet_avp.models.weights.agreement import NetworkMeaning
from pcdet_avp.registration import RegistrationSettings
from pcdet_avp.registry import DETECTORS
from pcdet_avp.structures.sensor_set import EGO_SOURCES, INFRA_SOURCES, SOURCES, modality_of
from pcdet_avp.structures.stage_times import untimed

BY_SOURCE = ("bev_maps", "bev_valid", "depth_logits", "latents", "latent_losses")  # what encoders and codec write
Link = Callable[[dict], dict]
Stage = Callable[[dict], dict]  # from batch to batch


def received_as_sent(latents: dict) -> dict:
    """The link of training: nothing is lost and nothing is late."""
    return latents


@DETECTORS.register("AvpCp")
class AvpCp(LoadableDetector):
    """Collaborative perception of a vehicle and a roadside mast, with OpenPCDet's interface.

    encode -> compress -> link -> (register) -> decompress -> warp -> merge units -> fuse -> backbone -> head

    One set of weights serves any non-empty subset of the four sources, sample by sample (``source_present``).
    ``link`` maps the roadside's latents, by source, to what the vehicle received of them: whoever sends real bytes
    puts the wire there. ``recompute_encoders``: training keeps no activations of the encoders (``models.recompute``).
    ``precision``: of inference, float32 or bf16 (``models.precision``).
    ``stages``: what each stage's work runs in (``structures.stage_times``); on a GPU it sees when work is handed over.
    """

    recompute_encoders = False
    precision = "float32"
    stages = staticmethod(untimed)

    def __init__(self, model_cfg: Any, num_class: int, dataset: Any) -> None:
        """ConfigError where ``num_class`` is not the number of the data set's classes."""
        super().__init__()
        if num_class != len(dataset.class_names):
            names = ", ".join(dataset.class_names)
            raise ConfigError(f"num_class: expected {len(dataset.class_names)} ({names}), found {num_class!r}")
        self.map_dropout = float(model_cfg.get("ROADSIDE_MAP_DROPOUT", 0.0))
        self.segment_dropout = float(model_cfg.get("ROADSIDE_SEGMENT_DROPOUT", 0.0))
        for name, module in build_modules(model_cfg, num_class, dataset).items():
            self.add_module(name, module)
        settings = RegistrationSettings.from_config(model_cfg)
        self.registration = RegisterMaps(self.warp.grid, settings, self.codec)
        self.post_processing = PostProcessing(require(model_cfg, "POST_PROCESSING", dict), dataset.class_names)
        self.add_global_step()
        self.meaning = NetworkMeaning.of(model_cfg, dataset)

    def forward(self, batch_dict: dict, link: Link = received_as_sent) -> tuple:
        """
        Args: batch_dict: what the data set collates, as tensors (see ``datasets.avp.prepare``)
        Returns:
            training: ({"loss": scalar}, tb_dict of scalars, disp_dict)
            evaluation: (pred_dicts, one per sample, recall_dict), see ``PostProcessing``
        """
        if not self.training:
            return self.post_processing(self.run_stages({**batch_dict, **self._asked_for()}, link))
        batch_dict = self.run_stages(batch_dict, link)
        loss, tb_dict = self.get_loss(batch_dict)
        return {"loss": loss}, tb_dict, {}

    def run_stages(self, batch_dict: dict, link: Link = received_as_sent) -> dict:
        """All stages in order; the batch with everything that they wrote."""
        check_sources(batch_dict)
        if self.training and self.map_dropout:
            batch_dict = drop_roadside_maps(batch_dict, self.map_dropout, int(self.global_step))
        batch_dict = self.codec.compress(self.encode(batch_dict))
        return self.fuse_and_detect({**batch_dict, "latents": link(self._on_the_air(batch_dict))})

    def encode_roadside(self, batch_dict: dict) -> dict[str, Latent]:
        """What the roadside sends, by source; of the batch only the roadside's sensors and poses are read."""
        return self.encode(batch_dict, INFRA_SOURCES, then=self._compress).get("latents", {})

    def encode_vehicle(self, batch_dict: dict) -> dict:
        """The batch with the vehicle's own maps; of the batch only the vehicle's sensors are read.

        Where it has ``latents``, too, and a core is free, they are brought to the vehicle's grid meanwhile.
        """
        if "latents" not in batch_dict or self.registration.settings.enabled or not pays(batch_dict["source_present"]):
            return self.encode(batch_dict, EGO_SOURCES)
        return {**self.encode(batch_dict, EGO_SOURCES, meanwhile=[self._place]), "placed": True}

    def detect(self, batch_dict: dict) -> list[dict]:
        """``fuse_and_detect`` and what post-processing makes of it: one of ``PostProcessing``'s pred_dicts a sample.

        The head may leave out anchors whose boxes nobody would see.
        """
        batch_dict = self.fuse_and_detect({**batch_dict, **self._asked_for()})
        with self.stages("post-processing"):
            return self.post_processing(batch_dict)[0]

    def _asked_for(self) -> dict:
        return {"min_scores": self.post_processing.min_scores}

    def fuse_and_detect(self, batch_dict: dict) -> dict:
        """From the vehicle's maps and ``latents``, what it received (of no source: nothing), to the head's boxes.

        Where MODEL.REGISTRATION is on, except in training, the received maps are registered first.
        """
        if not self.training:
            batch_dict = self._run([("register", self.registration)], batch_dict)
        batch_dict = batch_dict if batch_dict.get("placed") else self._place(batch_dict)
        stages = (("fuse", self.fuser), ("backbone", self.backbone_2d), ("head", self.dense_head))
        return self._run([("merge units", merge_units), *stages], batch_dict)

    def _place(self, batch_dict: dict) -> dict:
        """The maps in ``latents`` on the vehicle's grid."""
        return self._run([("decompress", self.codec.decompress), ("warp", self.warp)], batch_dict)

    def _run(self, stages: Sequence[tuple[str, Stage]], batch_dict: dict) -> dict:
        with computing_in(self.precision):
            for name, stage in stages:
                with self.stages(name):
                    batch_dict = stage(batch_dict)
        return batch_dict

    def _on_the_air(self, batch_dict: dict) -> dict:
        """The roadside's latents; in training, some of them without some of their segments."""
        latents = batch_dict["latents"]
        if self.training and self.segment_dropout:
            return drop_segments(latents, batch_dict["frame_id"], self.segment_dropout, int(self.global_step))
        return latents

    def encode(
        self,
        batch_dict: dict,
        sources: tuple[str, ...] = SOURCES,
        then: Stage | None = None,
        meanwhile: Sequence[Stage] = (),
    ) -> dict:
        """Maps of every source that any sample has; the encoders of the others do not run at all.

        ``then`` follows each encoder and is given its source's map alone. Stages of ``meanwhile`` fill the batch with
        maps of further sources, side by side with the encoders where that pays.
        """
        batch_dict = {**batch_dict, "bev_maps": {}, "bev_valid": {}}
        anywhere = batch_dict["source_present"].any(0).tolist()
        present = [source for source in sources if anywhere[SOURCES.index(source)]]
        tasks = [partial(self._encode_source, batch_dict, source, then) for source in present]
        tasks += [partial(stage, batch_dict) for stage in meanwhile]
        with computing_in(self.precision):
            encoded = side_by_side(tasks) if pays(batch_dict["source_present"]) else [task() for task in tasks]
        return reduce(_joined, encoded, batch_dict)

    def _encode_source(self, batch_dict: dict, source: str, then: Stage | None) -> dict:
        encoder = self.encoder_of(source)
        if self.recompute_encoders and torch.is_grad_enabled():
            encoded = recomputed(encoder, batch_dict, source)
        else:
            with self.stages(f"encode {source}"):
                encoded = encoder(batch_dict, source)
        return encoded if then is None else then(encoded)

    def _compress(self, batch_dict: dict) -> dict:
        with self.stages("compress"):
            return self.codec.compress(batch_dict)

    def encoder_of(self, source: str) -> nn.Module:
        """The encoder of a source: its own, or the one that both agents share."""
        return self.encoders[source if source in self.encoders else modality_of(source)]

    def get_loss(self, batch_dict: dict) -> tuple[Tensor, dict]:
        """The sum over all stages that have a loss, each with its own weights inside."""
        total, tb_dict = 0.0, {}
        for loss, terms in self._losses(batch_dict):
            total, tb_dict = total + loss, tb_dict | terms
        return total, tb_dict | {"loss": total.detach()}

    def _losses(self, batch_dict: dict) -> Iterator[tuple[Tensor, dict]]:
        for source in batch_dict["bev_maps"]:
            encoder = self.encoder_of(source)
            if hasattr(encoder, "get_loss"):
                yield encoder.get_loss(batch_dict, source)
        if hasattr(self.codec, "get_loss"):
            yield self.codec.get_loss(batch_dict)
        yield self.dense_head.get_loss(batch_dict)


def _joined(batch_dict: dict, encoded: dict) -> dict:
    """What two tasks wrote, each by the names of its sources."""
    written = {key: {**batch_dict.get(key, {}), **encoded[key]} for key in BY_SOURCE if key in encoded}
    return {**batch_dict, **encoded, **written}


def check_sources(batch_dict: dict) -> None:
    """Every sample needs at least one source."""
    blind = (batch_dict["source_present"].sum(1) == 0).nonzero().flatten().tolist()
    if blind:
        frames = ", ".join(str(batch_dict["frame_id"][i]) for i in blind)
        raise SensorError(f"no sensor at all in frame {frames}: expected at least one of {', '.join(SOURCES)}")
