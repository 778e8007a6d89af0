"""One frame through every point of the studies. The encoders, which take most of the time, run once."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from pcdet_avp.bandwidth.late_fusion import Boxes, in_roadside_range, merge
from pcdet_avp.bandwidth.plan import StudyPoint, Transmission
from pcdet_avp.bandwidth.transmit import Sent, segments_of, transmit, unsparsified
from pcdet_avp.link.nr_v2x import BYTES_PER_SLOT, NrV2xConfig
from pcdet_avp.models.compression import Latent
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet, modality_of

ROADSIDE = SensorSet(False, False, True, True)


@dataclass(frozen=True, eq=False)
class FrameResult:
    """What came of a frame. ``found`` by (combination, label), and what the roadside alone found; ``sent`` by label
    and source; ``blocks`` by MCS and source: transport blocks of a map as trained."""

    found: dict[tuple[str, str], Boxes] = field(default_factory=dict)
    roadside: Boxes | None = None
    sent: dict[str, dict[str, Sent]] = field(default_factory=dict)
    blocks: dict[int, dict[str, int]] = field(default_factory=dict)


class FrameRunner:
    """Runs frames: which points, with which combinations of sensors, on which MCS, from which seed."""

    def __init__(
        self, model: nn.Module, points: Sequence[StudyPoint], combos: Sequence[str], mcs: int, seed: int
    ) -> None:
        """``points`` as from ``make_plan``: the vehicle alone first, then what the network sends as trained."""
        self.model, self.points, self.mcs, self.seed = model, points, mcs, seed
        self.as_trained = points[1].transmission
        self.sensor_sets = {combo: SensorSet.parse(combo) for combo in combos}

    def __call__(self, batch_dict: dict) -> FrameResult:
        """``batch_dict``: one frame with all four sources, as ``load_batch`` returns it."""
        with torch.no_grad():
            frame = _Frame(self, batch_dict)
            found = {
                (combo, point.label): frame.detect(point, sensor_set)
                for point in self.points
                for combo, sensor_set in self.sensor_sets.items()
            }
            sent = {p.label: frame.received(p.transmission)[1] for p in self.points if p.transmission is not None}
            return FrameResult(found, frame.roadside(self.as_trained), sent, frame.blocks(self.as_trained))


class _Frame:
    """A frame behind the encoders; what was computed for one point is kept for the others."""

    def __init__(self, runner: FrameRunner, batch_dict: dict) -> None:
        self.runner, self.model = runner, runner.model
        self.key = zlib.crc32(str(batch_dict["frame_id"][0]).encode())
        self.batch = self.model.encode(batch_dict)
        compressed = self.model.codec.compress(self.batch)["latents"]
        self.sparsified = {source: latent.values[0] for source, latent in compressed.items()}
        self._received: dict[Transmission, tuple[dict[str, Latent], dict[str, Sent]]] = {}
        self._found: dict[tuple, Boxes] = {}

    def detect(self, point: StudyPoint, sensors: SensorSet) -> Boxes:
        """What the vehicle finds at a point of a study."""
        if point.objects:
            return merge(self.alone(sensors), self.roadside(self.runner.as_trained), self.post_processing)
        if point.transmission is None:
            return self.alone(sensors)
        return self.fused(sensors, self.received(point.transmission)[0], self.believed_pose(point))

    @property
    def post_processing(self):
        return self.model.post_processing

    def alone(self, sensors: SensorSet) -> Boxes:
        """From the vehicle's own sensors, as the network runs where there is no roadside."""
        batch = self.with_sources(SensorSet(sensors.ego_camera, sensors.ego_lidar, False, False))
        return self.post_process(self.model.fuse_and_detect(self.model.codec.compress(batch)))

    def roadside(self, transmission: Transmission) -> Boxes:
        """What the roadside's maps alone show, in the vehicle's frame."""
        pose = self.batch["ego_from_infra"]
        found = self.fused(ROADSIDE, self.received(transmission)[0], pose)
        return in_roadside_range(found, pose[0].double().cpu().numpy(), self.model.warp.grid)

    def fused(self, sensors: SensorSet, latents: Mapping[str, Latent], ego_from_infra: Tensor) -> Boxes:
        """From what the vehicle has and has received; computed once for equal inputs."""
        latents = {source: latent for source, latent in latents.items() if source in sensors.sources}
        key = (sensors, _fingerprint(ego_from_infra), *((s, _fingerprint(*_tensors(x))) for s, x in latents.items()))
        if key not in self._found:
            batch = {**self.with_sources(sensors), "latents": latents, "ego_from_infra": ego_from_infra}
            self._found[key] = self.post_process(self.model.fuse_and_detect(batch))
        return self._found[key]

    def with_sources(self, sensors: SensorSet) -> dict:
        """The encoded frame as a vehicle with these sensors has it."""
        used = [s for s in self.batch["bev_maps"] if s in sensors.sources]
        kept = {key: {s: self.batch[key][s] for s in used} for key in ("bev_maps", "bev_valid")}
        mask = self.batch["source_present"].new_tensor([sensors.mask])
        return {**self.batch, **kept, "source_present": mask * self.batch["source_present"]}

    def post_process(self, batch: dict) -> Boxes:
        found = self.post_processing(batch)[0][0]
        return Boxes(found["pred_boxes"], found["pred_scores"], found["pred_labels"])

    def received(self, transmission: Transmission) -> tuple[dict[str, Latent], dict[str, Sent]]:
        """What arrives of the frame's maps; whatever the loss, the same numbers decide which blocks it takes."""
        if transmission not in self._received:
            latents = self.sparsified if transmission.sparsified else self.unsparsified()
            rng = np.random.default_rng([self.runner.seed, self.key])
            self._received[transmission] = transmit(latents, transmission, self.runner.mcs, rng)
        return self._received[transmission]

    def unsparsified(self) -> dict[str, Tensor]:
        codec, maps = self.model.codec, self.batch["bev_maps"]
        return {source: unsparsified(codec.codec_of(source), maps[source])[0] for source in self.sparsified}

    def believed_pose(self, point: StudyPoint) -> Tensor:
        """``ego_from_infra`` (1, 4, 4) of a vehicle that errs about its own place; errors of all points are alike."""
        if point.position_std_m == point.yaw_std_deg == 0:
            return self.batch["ego_from_infra"]
        x, y, yaw = np.random.default_rng([self.runner.seed, self.key, 1]).standard_normal(3)
        error = Pose.from_xyz_yaw(
            point.position_std_m * x, point.position_std_m * y, yaw=np.radians(point.yaw_std_deg) * yaw
        )
        return self.batch["ego_from_infra"].new_tensor(error.matrix) @ self.batch["ego_from_infra"]

    def blocks(self, transmission: Transmission) -> dict[int, dict[str, int]]:
        """Transport blocks of every map, by MCS."""
        rooms = {mcs: NrV2xConfig(mcs=mcs).max_segment_bytes for mcs in BYTES_PER_SLOT}
        return {
            mcs: {s: len(segments_of(x, modality_of(s), transmission, room)) for s, x in self.sparsified.items()}
            for mcs, room in rooms.items()
        }


def _tensors(latent: Latent) -> tuple[Tensor, Tensor]:
    return latent.values, latent.received


def _fingerprint(*tensors: Tensor) -> bytes:
    return b"".join(t.detach().cpu().contiguous().numpy().tobytes() for t in tensors)
