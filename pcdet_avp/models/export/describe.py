"""What the graphs of a network leave open (``deploy.network.Network``), read from its modules."""

from __future__ import annotations

from torch import nn

from pcdet_avp.deploy.network import AnchorSet, CameraInput, DepthBinning, Head, Network, PillarInput, Suppression
from pcdet_avp.errors import ExportError
from pcdet_avp.models.backbones_3d.vfe.dynamic_pillars import DynamicPillars
from pcdet_avp.models.backbones_image.image_backbone import STRIDE
from pcdet_avp.models.compression.map_packets import precisions
from pcdet_avp.models.detectors.avp_cp import AvpCp
from pcdet_avp.models.detectors.post_processing import PostProcessing
from pcdet_avp.models.detectors.split_inference import latent_shape
from pcdet_avp.models.encoders.camera_encoder import CameraEncoder


def describe(model: nn.Module, class_names: list[str]) -> Network:
    """ExportError or ConfigError where the network has a stage that has no form, or sends no bytes."""
    if not isinstance(model, AvpCp):
        raise ExportError(
            f"MODEL.NAME: expected AvpCp, found {type(model).__name__}, which is no network in two halves"
        )
    sent_as = precisions(model.codec, "--out")
    grid, codecs = model.warp.grid, model.codec.codecs
    return Network(
        class_names=tuple(class_names),
        point_cloud_range=grid.range,
        cell_m=grid.cell_m,
        channels=model.encoder_of("ego_lidar").channels,
        latent_shape=latent_shape(model),
        latent_precision=sent_as,
        pooling=next(iter(codecs.values())).pooling,
        cameras={agent: _camera(model.encoder_of(f"{agent}_camera"), agent) for agent in ("ego", "infra")},
        pillars=_pillars(model.encoder_of("ego_lidar").vfe),
        head=_head(model),
        suppression=suppression_of(model.post_processing),
        map_size=model.codec.map_size,
    )


def suppression_of(post: PostProcessing) -> Suppression:
    """The thresholds of a network's post-processing."""
    by_class = tuple(post.min_scores), tuple(post.max_overlaps)
    return Suppression(*by_class, post.pre_max, post.post_max, tuple(post.vote_overlaps))


def _camera(encoder: CameraEncoder, agent: str) -> CameraInput:
    bins, to_bev = encoder.bins[agent], encoder.map_to_bev_module
    binning = DepthBinning(bins.mode, bins.count, bins.near_m, bins.far_m)
    return CameraInput(encoder.crop_px[agent], STRIDE, to_bev.num_heights, to_bev.sampling, binning)


def _pillars(vfe: DynamicPillars) -> PillarInput:
    other, grid = vfe.as_openpcdet, vfe.grid
    return PillarInput(
        layers=len(vfe.pfn_layers),
        absolute=vfe.absolute,
        scaled=not vfe.batch_norm,
        lidar_height_m=other.lidar_height_m if other else 0.0,
        centre_z_m=other.centre_z_m if other else (grid.z_min_m + grid.z_max_m) / 2,
        max_points=other.max_points if other else 0,
    )


def _head(model: AvpCp) -> Head:
    head = model.dense_head
    anchors = tuple(AnchorSet(tuple(map(tuple, one.boxes().tolist())), one.align_center) for one in head.classes)
    return Head(anchors, model.warp.grid.height // head.map_shape[0], head.bins, head.direction_offset)
