"""Which graphs a network becomes: their files, forms, and inputs to trace them with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from pcdet_avp.deploy import frustum, warp
from pcdet_avp.deploy.network import Network
from pcdet_avp.models.detectors.avp_cp import AvpCp
from pcdet_avp.models.export import forms
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose

POINTS = 64  # rows that a point network is traced with; their number stays symbolic
FREE_ROWS = {"rows": "points", "pixels": "columns", "weights": "columns", "bins": "columns", "bin_shift": "columns"}


@dataclass(frozen=True, eq=False)
class Piece:
    """One graph: its file below the folder, its form, inputs and names of outputs.

    ``free``: names of the inputs whose first axis has any length, and the name of that length.
    """

    file: str
    form: nn.Module
    inputs: dict[str, Tensor]
    outputs: tuple[str, ...]
    free: dict[str, str]


def pieces(model: AvpCp, network: Network, image_shape: tuple[int, int]) -> Iterator[Piece]:
    """Every graph of both halves; ``image_shape`` (rows, columns) is that of all images."""
    generator = torch.Generator().manual_seed(0)
    for half, agent in (("roadside", "infra"), ("vehicle", "ego")):
        yield _camera(f"{half}/camera.onnx", model, network, agent, image_shape, generator)
        yield from _lidar(half, model, network, agent, generator)
    for modality, codec in model.codec.codecs.items():
        sent, received = {"bev_map": _map(network, generator)}, {"latent": _latent(network, generator)}
        yield Piece(f"roadside/compress_{modality}.onnx", forms.CompressForm(codec), sent, ("latent",), {})
        yield Piece(f"vehicle/decompress_{modality}.onnx", forms.DecompressForm(codec), received, ("bev_map",), {})
    yield from _behind_the_link(model, network, generator)


def _camera(file, model, network, agent, image_shape, generator) -> Piece:
    """Traced with a camera 2.5 m above the floor that looks ahead and a little down."""
    camera = network.cameras[agent]
    rows, columns = image_shape
    eye = PinholeCamera.looking_ahead(columns, rows, np.pi / 2, 0.0, 2.5, 0.2)
    to_img = np.concatenate([eye.intrinsics, np.zeros((3, 1))], 1)
    matrix = frustum.image_from_agent(eye.agent_from_camera.inverse().matrix, to_img, camera.crop_px)
    tables = frustum.tables(matrix, network.grid, camera, (rows - camera.crop_px, columns))
    inputs = {"image": torch.rand(1, 3, rows, columns, generator=generator)}
    inputs |= {name: torch.from_numpy(table) for name, table in vars(tables).items()}
    free = {name: axis for name, axis in FREE_ROWS.items() if name in inputs}
    return Piece(file, forms.CameraForm(model.encoder_of(f"{agent}_camera"), agent), inputs, ("bev_map",), free)


def _lidar(half, model, network, agent, generator) -> Iterator[Piece]:
    encoder = model.encoder_of(f"{agent}_lidar")
    for i, layer in enumerate(encoder.vfe.pfn_layers):
        rows = torch.rand(POINTS, layer.linear.in_features, generator=generator)
        yield Piece(
            f"{half}/points_{i}.onnx", forms.PointsForm(layer), {"rows": rows}, ("features",), {"rows": "points"}
        )
    pillar_map = _map(network, generator).permute(0, 2, 3, 1).contiguous()
    yield Piece(f"{half}/lidar.onnx", forms.LidarForm(encoder), {"pillar_map": pillar_map}, ("bev_map",), {})


def _behind_the_link(model, network, generator) -> Iterator[Piece]:
    fused, valid = _map(network, generator), _map(network, generator)[:, :1] > 0.3
    cells, weights = map(torch.from_numpy, warp.neighbours(Pose.from_xyz_yaw(20.0, 1.0, yaw=3.0).matrix, network.grid))
    inputs = {"bev_map": fused, "valid": valid, "cells": cells, "weights": weights}
    yield Piece("vehicle/warp.onnx", forms.WarpForm(network.grid), inputs, ("warped_map", "warped_valid"), {})
    inputs = {}
    for source in ("ego_camera", "ego_lidar", "infra_camera", "infra_lidar"):
        inputs[source] = _map(network, generator)
        inputs[f"{source}_valid"] = _map(network, generator)[:, :1] > 0.3
    yield Piece("vehicle/fuse.onnx", forms.FuseForm(model.fuser), inputs, ("spatial_features",), {})
    backbone = forms.BackboneForm(model.backbone_2d)
    yield Piece("vehicle/backbone.onnx", backbone, {"spatial_features": fused}, ("spatial_features_2d",), {})
    features = torch.rand(1, model.backbone_2d.num_bev_features, *model.dense_head.map_shape, generator=generator)
    outputs = ("cls_preds", "box_preds", "dir_cls_preds")[: 3 if model.dense_head.bins else 2]
    yield Piece("vehicle/head.onnx", forms.HeadForm(model.dense_head), {"spatial_features_2d": features}, outputs, {})


def _map(network: Network, generator: torch.Generator) -> Tensor:
    """A random map (1, C, H, W), none of it negative."""
    return torch.rand(1, network.channels, network.grid.height, network.grid.width, generator=generator)


def _latent(network: Network, generator: torch.Generator) -> Tensor:
    """A random latent (1, c, h, w)."""
    return torch.rand(1, *network.latent_shape, generator=generator)
