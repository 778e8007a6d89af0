"""The mast's computer: from its own sensors to packets. It knows nothing of the vehicle."""

from __future__ import annotations

import torch

from pcdet_avp.closed_loop.driving_network import DrivingNetwork
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.link.header import MapStamp
from pcdet_avp.models.compression.map_packets import MapPacker
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.sensor_set import SensorSet


class RoadsideUnit:
    """Encodes, compresses and packs what the roadside's sensors see."""

    def __init__(self, driving: DrivingNetwork, max_segment_bytes: int) -> None:
        self._driving = driving
        self._packer = MapPacker(driving.network.codec, max_segment_bytes, "--perception model")

    def packets(self, frame: Frame, camera: bool, lidar: bool, number: int) -> dict[str, list[bytes]]:
        """{source: segments of its map} of the sensors in use; of the frame only the roadside's view is read.

        ``number`` is the frame id in the packets.
        """
        sample = prepare(frame, SensorSet(False, False, camera, lidar), self._driving.input.prepare_config)
        batch_dict = load_batch(collate([sample]), self._driving.device)
        with self._driving.computing():
            latents = self._driving.network.encode_roadside(batch_dict)
        return {source: self._pack(latent.values[0], source, frame, number) for source, latent in latents.items()}

    def _pack(self, values: torch.Tensor, source: str, frame: Frame, number: int) -> list[bytes]:
        modality, time_us = source.split("_")[1], round(1e6 * frame.time_s)
        stamp = MapStamp.at_pose(number, time_us, modality, frame.infra.world_from_agent)
        return self._packer.pack(values, stamp)
