"""One frame through every point of the studies. The encoders, which take most of the time, run once."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor, nn

from pcdet_avp.bandwidth.late_fusion import Boxes, from_objects, in_roadside_range, merge, moved, to_objects
from pcdet_avp.bandwidth.plan import StudyPoint, Transmission
from pcdet_avp.bandwidth.transmit import Sent, segments_of, transmit, unsparsified
from pcdet_avp.link.nr_v2x import BYTES_PER_SLOT, NrV2xConfig
from pcdet_avp.models.compression import Latent
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet, modality_of


@dataclass(frozen=True, eq=False)
class FrameResult:
    """What came of a frame. ``found`` by (combination, label); ``roadside`` by combination: what the roadside alone
    found with its sensors of that combination, in its own frame; ``sent`` by label and source; ``blocks`` by MCS and
    source: transport blocks of a map as trained."""

    found: dict[tuple[str, str], Boxes] = field(default_factory=dict)
    roadside: dict[str, Boxes] = field(default_factory=dict)
    sent: dict[str, dict[str, Sent]] = field(default_factory=dict)
    blocks: dict[int, dict[str, int]] = field(default_factory=dict)


class FrameRunner:
    """Runs frames: which points, with which combinations of sensors, on which MCS, from which seed."""

    def __init__(
        self,
        model: nn.Module,
        points: Sequence[StudyPoint],
        combos: Sequence[str],
        mcs: int,
        seed: int,
        class_names: Sequence[str],
    ) -> None:
        """``points`` as from ``make_plan``: the vehicle alone first, then what the network sends as trained;
        ``class_names`` in the order of the network's labels."""
        self.model, self.points, self.mcs, self.seed, self.class_names = model, points, mcs, seed, list(class_names)
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
            lists = {combo: frame.roadside_list(sensors) for combo, sensors in self.sensor_sets.items()}
            return FrameResult(found, lists, sent, frame.blocks(self.as_trained))


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
            roadside = self.from_message(sensors) if point.coded else self.roadside(sensors)
            return merge(self.alone(sensors), roadside, self.post_processing)
        if point.transmission is None:
            return self.alone(sensors)
        return self.fused(sensors, self.received(point.transmission)[0], self.believed_pose(point))

    @property
    def post_processing(self):
        return self.model.post_processing

    def alone(self, sensors: SensorSet) -> Boxes:
        """Detections from the vehicle's own sensors, as the network runs without a roadside unit."""
        batch = self.with_sources(SensorSet(sensors.ego_camera, sensors.ego_lidar, False, False))
        return self.post_process(self.model.fuse_and_detect(self.model.codec.compress(batch)))

    @property
    def ego_from_infra(self) -> Pose:
        return Pose(self.batch["ego_from_infra"][0].double().cpu().numpy())

    def roadside(self, sensors: SensorSet) -> Boxes:
        """What the maps, as trained, of the combination's roadside sensors alone show, in the vehicle's frame."""
        roadside = SensorSet(False, False, sensors.infra_camera, sensors.infra_lidar)
        found = self.fused(roadside, self.received(self.runner.as_trained)[0], self.batch["ego_from_infra"])
        return in_roadside_range(found, self.ego_from_infra.matrix, self.model.warp.grid)

    def roadside_list(self, sensors: SensorSet) -> Boxes:
        """The same in the roadside's own frame, which is the message's."""
        return moved(self.roadside(sensors), self.ego_from_infra.inverse())

    def from_message(self, sensors: SensorSet) -> Boxes:
        """What the vehicle, in its frame, reads out of the roadside's message."""
        names, roadside = self.runner.class_names, self.roadside_list(sensors)
        got = from_objects(to_objects(roadside, names), names)
        return moved(got, self.ego_from_infra).like(self.batch["ego_from_infra"])

    def fused(self, sensors: SensorSet, latents: Mapping[str, Latent], ego_from_infra: Tensor) -> Boxes:
        """Detections from the vehicle's own maps and those that it received; computed once for equal inputs."""
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
        """Transport blocks of every map, by MCS; without padding where a map of constant size is no single block."""
        rooms = {mcs: NrV2xConfig(mcs=mcs).max_segment_bytes for mcs in BYTES_PER_SLOT}
        ways = {mcs: replace(transmission, size=transmission.size.in_segments(room)) for mcs, room in rooms.items()}
        return {
            mcs: {s: len(segments_of(x, modality_of(s), ways[mcs], room)) for s, x in self.sparsified.items()}
            for mcs, room in rooms.items()
        }


def _tensors(latent: Latent) -> tuple[Tensor, Tensor]:
    return latent.values, latent.received


def _fingerprint(*tensors: Tensor) -> bytes:
    return b"".join(t.detach().cpu().contiguous().numpy().tobytes() for t in tensors)
