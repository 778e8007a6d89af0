"""The path under which ``film_episode`` was published; it lives in ``closed_loop.video.video``."""

from pcdet_avp.closed_loop.video.video import write_episode_video as film_episode

__all__ = ["film_episode"]
