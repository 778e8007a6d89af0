"""Files as parts of a page: data URIs of pictures and videos, in formats that browsers show."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from pathlib import Path

import cv2
from PIL import Image

from pcdet_avp.errors import ConfigError
from pcdet_avp.visualization.video import read_picture

# What browsers play, as OpenCV reads it back from a file.
BROWSER_CODECS = {"VP90": "VP9", "VP80": "VP8", "avc1": "H.264", "h264": "H.264", "av01": "AV1"}
VIDEO_TYPES = {".mp4": "video/mp4", ".webm": "video/webm"}
WEBP_QUALITY = 88
ANIMATION_WIDTH_PX, ANIMATION_QUALITY = 960, 60


@dataclass(frozen=True)
class Embedded:
    """uri: a data URI; width and height in pixels."""

    uri: str
    width: int
    height: int


def data_uri(content: bytes, media_type: str) -> str:
    return f"data:{media_type};base64,{base64.b64encode(content).decode('ascii')}"


def embedded_picture(file: Path) -> Embedded:
    """A picture as WebP, or as the PNG that it is where that is smaller. ConfigError where it cannot be read."""
    image, content = read_picture(file), file.read_bytes()
    webp = cv2.imencode(".webp", image[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])[1].tobytes()
    height, width = image.shape[:2]
    if file.suffix == ".png" and len(content) <= len(webp):
        return Embedded(data_uri(content, "image/png"), width, height)
    return Embedded(data_uri(webp, "image/webp"), width, height)


def plays_in_browsers(file: Path) -> bool:
    """Whether the video's codec and container are among those that browsers play."""
    return _codec(file) in BROWSER_CODECS and file.suffix in VIDEO_TYPES


def embedded_video(file: Path) -> Embedded:
    """A video that plays in browsers, as it is. ConfigError where it does not."""
    if not plays_in_browsers(file):
        wanted = ", ".join(dict.fromkeys(BROWSER_CODECS.values()))
        raise ConfigError(f"{file}: expected {wanted} in {' or '.join(VIDEO_TYPES)}, found codec {_codec(file)!r}")
    capture = cv2.VideoCapture(str(file))
    width, height = (int(capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    capture.release()
    return Embedded(data_uri(file.read_bytes(), VIDEO_TYPES[file.suffix]), width, height)


def embedded_animation(file: Path) -> Embedded:
    """Any video that OpenCV reads, as an animated WebP that runs once: for videos that browsers do not play."""
    capture = cv2.VideoCapture(str(file))
    fps, images = capture.get(cv2.CAP_PROP_FPS), []
    while (read := capture.read())[0]:
        scale = min(1.0, ANIMATION_WIDTH_PX / read[1].shape[1])
        smaller = cv2.resize(read[1], None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        images.append(Image.fromarray(smaller[..., ::-1]))
    capture.release()
    if not images or fps <= 0:
        raise ConfigError(f"{file}: expected a video, found none that OpenCV reads")
    stream = io.BytesIO()
    how = {"save_all": True, "append_images": images[1:], "duration": round(1000 / fps), "loop": 1}
    images[0].save(stream, "WEBP", quality=ANIMATION_QUALITY, **how)
    return Embedded(data_uri(stream.getvalue(), "image/webp"), *images[0].size)


def _codec(file: Path) -> str:
    """Four letters; ConfigError where there is no such file."""
    if not file.exists():
        raise ConfigError(f"{file}: no such file")
    capture = cv2.VideoCapture(str(file))
    number = int(capture.get(cv2.CAP_PROP_FOURCC)) if capture.isOpened() else 0
    capture.release()
    return number.to_bytes(4, "little").decode("ascii", "replace")
