"""Both halves of an exported network: sensors to bytes at the mast, sensors and bytes to boxes in the vehicle.

They take a sample as ``datasets.avp.prepare`` makes it (numpy, one frame) and answer what the halves of
``models.detectors.split_inference`` answer. The graphs of an agent are loaded when they are first needed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pcdet_avp.deploy import frustum, pillars, post_processing, warp
from pcdet_avp.deploy.manifest import Exported
from pcdet_avp.deploy.network import Network, Suppression
from pcdet_avp.deploy.runtime import Arrays, Graph, Runtime
from pcdet_avp.errors import SensorError
from pcdet_avp.link import LatentMap, MapStamp
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.link.units import by_source
from pcdet_avp.registration import Registrar, RegistrationSettings, SteadyCorrection
from pcdet_avp.registration.registrar import OWN, SENT
from pcdet_avp.registration.registrar import Received as ReceivedMap
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import EGO_SOURCES, INFRA_SOURCES, SOURCES, modality_of
from pcdet_avp.structures.stage_times import Stages, untimed

Sample = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Received:
    """A roadside map as the vehicle holds it: values (c, h, w), present (h, w) bool, ego_from_sender (4, 4)."""

    values: np.ndarray
    present: np.ndarray
    ego_from_sender: np.ndarray


@dataclass(frozen=True, eq=False)
class Opened:
    """The same, decompressed: bev_map (1, C, H, W), still on its sender's grid."""

    bev_map: np.ndarray
    present: np.ndarray
    ego_from_sender: np.ndarray

    def pooled(self) -> np.ndarray:
        """(C, h, w): one of the cells that were pooled, which are equal."""
        pooling = self.bev_map.shape[-1] // self.present.shape[-1]
        return self.bev_map[0, :, ::pooling, ::pooling]


class Graphs:
    """The graphs of one half, by their names without folder and suffix."""

    def __init__(self, exported: Exported, runtime: Runtime, half: str) -> None:
        self._exported, self._runtime, self._half = exported, runtime, half
        self._loaded: dict[str, Graph] = {}

    def __call__(self, name: str, **inputs: np.ndarray) -> Arrays:
        """Outputs of a graph, by name; SensorError where an input holds NaN or infinite values.

        Looked for before the graph, since runtimes make ordinary numbers of NaN (OpenVINO in every ReLU).
        """
        for key, value in inputs.items():
            if value.dtype.kind == "f" and not np.isfinite(value).all():
                bad = int((~np.isfinite(value)).sum())
                raise SensorError(
                    f"{self._half}/{name}.onnx: {key}: expected finite values, found {bad} of {value.size} "
                    "that are NaN or infinite"
                )
        if name not in self._loaded:
            file = f"{self._half}/{name}.onnx"
            self._loaded[name] = self._runtime.load(self._exported.graph(file), str(self._exported.folder / file))
        return self._loaded[name]({key: np.ascontiguousarray(value) for key, value in inputs.items()})


class Encoders:
    """One agent's sensors to maps (1, C, H, W) and masks (1, 1, H, W) bool on that agent's grid."""

    def __init__(self, graphs: Graphs, network: Network, agent: str) -> None:
        self._graphs, self._network, self._grid = graphs, network, network.grid
        self._camera, self._suffix = network.cameras[agent], "_infra" if agent == "infra" else ""

    def encode(self, sample: Sample, source: str) -> tuple[np.ndarray, np.ndarray]:
        """The map of one of the agent's sources."""
        encoder: Callable = self._encode_camera if modality_of(source) == "camera" else self._encode_lidar
        return encoder(sample)

    def _encode_camera(self, sample: Sample) -> tuple[np.ndarray, np.ndarray]:
        image = sample["images" + self._suffix]
        if image.ndim != 3 or image.shape[2] != 3:
            raise SensorError(f"images{self._suffix}: expected shape (h, w, 3), found {image.shape}")
        cam_from_agent, image_from_cam = (
            sample["trans_lidar_to_cam" + self._suffix],
            sample["trans_cam_to_img" + self._suffix],
        )
        matrix = frustum.image_from_agent(cam_from_agent, image_from_cam, self._camera.crop_px)
        size = (image.shape[0] - self._camera.crop_px, image.shape[1])
        tables = frustum.tables(matrix, self._grid, self._camera, size)
        x = self._graphs("camera", image=image.transpose(2, 0, 1)[None], **vars(tables))["bev_map"]
        return x, (tables.row_of_cell > 0).reshape(1, 1, self._grid.height, self._grid.width)

    def _encode_lidar(self, sample: Sample) -> tuple[np.ndarray, np.ndarray]:
        shape = (self._grid.height, self._grid.width)
        x, cells = pillars.decorate(sample["points" + self._suffix], self._grid, self._network.pillars)
        highest = np.zeros((shape[0] * shape[1], self._network.channels), np.float32)
        for i in range(self._network.pillars.layers if len(x) else 0):
            x = self._graphs(f"points_{i}", rows=x)["features"]
            highest = pillars.maxima(x, cells, shape[0] * shape[1])
            x = np.concatenate([x, highest[cells]], 1) if i + 1 < self._network.pillars.layers else x
        bev_map = self._graphs("lidar", pillar_map=highest.reshape(1, *shape, -1))["bev_map"]
        return bev_map, np.ones((1, 1, *shape), bool)


class RoadsideHalf:
    """Sensors to segments: encoders, compressor, packer."""

    def __init__(
        self, exported: Exported, runtime: Runtime, max_segment_bytes: int, map_size: MapSize | None = None
    ) -> None:
        """``map_size``: what a map may take, in place of what was exported."""
        self.stages: Stages = untimed  # what each stage's work runs in
        self.network_number = 0  # what its maps say of the network that made them; 0: nothing
        self._network, self._graphs = exported.network, Graphs(exported, runtime, "roadside")
        self._encoders = Encoders(self._graphs, self._network, "infra")
        self._max_segment_bytes, self._size = max_segment_bytes, map_size or self._network.map_size
        self._size.check_segments(max_segment_bytes)

    def latents(self, sample: Sample) -> dict[str, np.ndarray]:
        """By source, the compressed map (c, h, w) of each roadside sensor that the sample has."""
        compressed = {}
        for source in present_sources(sample, INFRA_SOURCES):
            with self.stages(f"encode {source}"):
                bev_map, _ = self._encoders.encode(sample, source)
            with self.stages("compress"):
                compressed[source] = self.compress(bev_map, source)
        return compressed

    def compress(self, bev_map: np.ndarray, source: str) -> np.ndarray:
        """A map (1, C, H, W) -> what is sent of it, (c, h, w)."""
        return self._graphs(f"compress_{modality_of(source)}", bev_map=bev_map)["latent"][0]

    def pack(self, latent: np.ndarray, stamp: MapStamp) -> list[bytes]:
        """Segments of a map (c, h, w)."""
        precision = self._network.latent_precision[stamp.modality]
        return self._size.pack(latent, stamp, self._max_segment_bytes, precision)

    def segments(
        self, sample: Sample, frame_id: int, time_us: int, world_from_infra: Pose, sender: int = 0
    ) -> dict[str, list[bytes]]:
        """source -> segments of one frame's map; of the sample only the roadside's sensors are read.

        ``sender`` is the unit's number at its site.
        """
        packed = {}
        for source, latent in self.latents(sample).items():
            origin = sender, self.network_number
            stamp = MapStamp.at_pose(frame_id, time_us, modality_of(source), world_from_infra, *origin)
            with self.stages("pack"):
                packed[source] = self.pack(latent, stamp)
        return packed


class VehicleHalf:
    """Sensors and received maps to boxes: encoders, decompress, warp, fuse, backbone, head, post-processing."""

    def __init__(
        self,
        exported: Exported,
        runtime: Runtime,
        suppression: Suppression | None = None,
        registration: RegistrationSettings | None = None,
        follows_time: bool = False,
    ) -> None:
        """``suppression``: thresholds instead of those that were exported. ``registration``: None or not enabled, maps
        stay where their poses place them; with ``follows_time``, corrections are smoothed from frame to frame."""
        self.stages: Stages = untimed  # what each stage's work runs in
        self._network, self._graphs = exported.network, Graphs(exported, runtime, "vehicle")
        self._encoders = Encoders(self._graphs, self._network, "ego")
        self._suppression = suppression or self._network.suppression
        self.shape = self._network.latent_shape
        self._registrar: Registrar | None = None
        self._memory: SteadyCorrection | None = None
        if registration is not None and registration.enabled:
            self._registrar = Registrar(self._network.grid, registration)
            self._memory = SteadyCorrection(registration.frames) if follows_time else None

    def detect(self, sample: Sample, world_from_ego: Pose, maps: Collection[LatentMap]) -> post_processing.Detected:
        """pred_boxes (n, 7), pred_scores (n,), pred_labels (n,) in the ego frame; the maps' own poses place them.

        The maps may be of any number of roadside units; two of one unit and source are a LinkError.
        """
        ego_from_world = world_from_ego.inverse()
        received = {
            source: [
                Received(
                    known.values,
                    known.present,
                    (ego_from_world @ known.stamp.world_from_agent).matrix.astype(np.float32),
                )
                for known in of_units
            ]
            for source, of_units in by_source(maps).items()
        }
        return self.post_process(self.run(sample, received))

    def post_process(self, outputs: Arrays) -> post_processing.Detected:
        """What ``detect`` makes of the head's raw outputs."""
        with self.stages("post-processing"):
            return post_processing.detect(outputs, self._network.grid, self._network.head, self._suppression)

    def run(self, sample: Sample, received: Mapping[str, Received | Sequence[Received]]) -> Arrays:
        """The head's raw outputs; of the sample only the vehicle's sensors are read. SensorError without any map.

        ``received``: of every roadside source one map, or those of several units.
        """
        maps = {}
        for source in present_sources(sample, EGO_SOURCES):
            with self.stages(f"encode {source}"):
                maps[source] = self._encoders.encode(sample, source)
        with self.stages("decompress"):
            of_source = {
                source: [self._opened(source, each) for each in ([r] if isinstance(r, Received) else r)]
                for source, r in received.items()
            }
        with self.stages("register"):
            of_source = self._registered(maps, of_source)
        for source, of_units in of_source.items():
            placed = [self._placed(each) for each in of_units]
            with self.stages("merge units"):
                maps[source] = merged(placed)
        if not maps:
            raise SensorError("fusion: no feature map from any of the four sources")
        return self.head(maps)

    def _opened(self, source: str, known: Received) -> Opened:
        """A received map, decompressed."""
        latent = np.where(known.present, known.values, np.float32(0))[None]
        bev_map = self._graphs(f"decompress_{modality_of(source)}", latent=latent)["bev_map"]
        return Opened(bev_map, known.present, known.ego_from_sender)

    def _registered(
        self, maps: Mapping[str, tuple[np.ndarray, np.ndarray]], received: dict[str, list[Opened]]
    ) -> dict[str, list[Opened]]:
        """What was received, its poses corrected where registration is on; as ``models.fusion.register`` does it."""
        if self._registrar is None:
            return received
        own = {name: (maps[name][0][0], maps[name][1][0, 0]) for name in (OWN,) if name in maps}
        sent = [ReceivedMap(r.pooled(), Pose(r.ego_from_sender)) for r in received.get(SENT, [])]
        correction = self._registrar(own, sent)
        pose = correction.true_from_believed if self._memory is None else self._memory(correction)
        if np.array_equal(pose.matrix, np.eye(4)):
            return received
        return {
            source: [replace(r, ego_from_sender=(pose.matrix @ r.ego_from_sender).astype(np.float32)) for r in of_units]
            for source, of_units in received.items()
        }

    def head(self, maps: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Arrays:
        """Raw outputs from the maps and masks on the ego grid; a source that is left out is absent everywhere."""
        shape = (self._network.grid.height, self._network.grid.width)
        nothing = np.zeros((1, self._network.channels, *shape), np.float32), np.zeros((1, 1, *shape), bool)
        inputs = {}
        for source in SOURCES:
            inputs[source], inputs[f"{source}_valid"] = maps.get(source, nothing)
        with self.stages("fuse"):
            x = self._graphs("fuse", **inputs)["spatial_features"]
        with self.stages("backbone"):
            features = self._graphs("backbone", spatial_features=x)
        with self.stages("head"):
            return self._graphs("head", **features)

    def _placed(self, known: Opened) -> tuple[np.ndarray, np.ndarray]:
        """A received map on the ego grid, and its mask."""
        with self.stages("warp"):
            pooling = self._network.pooling
            valid = known.present.repeat(pooling, 0).repeat(pooling, 1)[None, None]
            cells, weights = warp.neighbours(known.ego_from_sender, self._network.grid)
            warped = self._graphs("warp", bev_map=known.bev_map, valid=valid, cells=cells, weights=weights)
        return warped["warped_map"], warped["warped_valid"]


def merged(placed: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Maps (1, C, H, W) of several units and their masks on the ego grid -> one of each, by the rule of
    ``models.fusion.units``: in every cell the longest vector; of equal lengths, the maximum of elements."""
    if len(placed) == 1:
        return placed[0]
    maps, masks = (np.concatenate(parts) for parts in zip(*placed, strict=True))
    length = np.where(masks, np.square(maps).sum(1, keepdims=True), np.float32(-1))
    present, chosen = np.any(masks, axis=0, keepdims=True), masks & (length == length.max(0))
    highest = np.where(chosen, maps, np.float32(-np.inf)).max(0, keepdims=True)
    return np.where(present, highest, np.float32(0)), present


def present_sources(sample: Sample, sources: Collection[str]) -> list[str]:
    """Those of ``sources`` that a sample has."""
    return [source for source in sources if sample["source_present"][SOURCES.index(source)]]
