"""Layers from features to bird's-eye-view maps; importing this package registers them under ``MAP_TO_BEV``."""

from pcdet_avp.models.backbones_2d.map_to_bev.frustum_to_bev import FrustumToBev
from pcdet_avp.models.backbones_2d.map_to_bev.pillar_scatter import PillarScatter

__all__ = ["FrustumToBev", "PillarScatter"]
