"""The trained half of the compression of roadside maps; importing this package registers it."""

from pcdet_avp.models.compression.bev_codec import BevCodec, Latent, NoCompression

__all__ = ["BevCodec", "Latent", "NoCompression"]
