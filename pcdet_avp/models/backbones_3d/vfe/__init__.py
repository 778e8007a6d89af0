"""Feature extractors of single sensors; importing this package registers them under ``VFE``."""

from pcdet_avp.models.backbones_3d.vfe.dynamic_pillars import DynamicPillars

__all__ = ["DynamicPillars"]
