"""Pictures and videos as files, whole or not at all; only what OpenCV's wheel brings along is needed."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from pathlib import Path

import cv2
import numpy as np

from pcdet_avp.errors import ConfigError, OutputError
from pcdet_avp.files import make_folder, replacing, write_bytes

# The first with the file's ending that this OpenCV can write is taken: VP9 plays in browsers, the others in desktop
# players.
CODECS = (("vp09", ".mp4"), ("mp4v", ".mp4"), ("MJPG", ".avi"))
ENDINGS = (".mp4", ".avi")


def write_picture(file: Path, image: np.ndarray) -> None:
    """Save image (H, W, 3) uint8 RGB; the file's ending names the format."""
    write_bytes(file, cv2.imencode(file.suffix, image[..., ::-1])[1].tobytes())


def read_picture(file: Path) -> np.ndarray:
    """(H, W, 3) uint8 RGB; ConfigError where there is no picture."""
    try:
        content = np.frombuffer(file.read_bytes(), np.uint8)
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read ({error.strerror})") from error
    image = cv2.imdecode(content, cv2.IMREAD_COLOR) if len(content) else None
    if image is None:
        raise ConfigError(f"{file}: expected a picture, found {len(content)} bytes that are none")
    return image[..., ::-1]


def check_video_name(file: Path) -> None:
    """ConfigError for a name whose ending is no container's that ``write_video`` knows, such as .gif."""
    if file.suffix.lower() not in ENDINGS:
        raise ConfigError(
            f"{file}: expected a video's name, *{' or *'.join(ENDINGS)}, found the ending {file.suffix!r}"
        )


def write_video(file: Path, images: Iterable[np.ndarray], fps: float) -> Path:
    """Save images (H, W, 3) uint8 RGB, all of one size, as a video.

    Returns its path: that of ``file``, with another ending if only another container can be written. OutputError if
    there are no images, or the file cannot be written; ConfigError for a name that is no video's.
    """
    check_video_name(file)
    images = iter(images)
    first = next(images, None)
    if first is None:
        raise OutputError(f"{file}: a video needs at least one picture")
    writer, target = _open(file, fps, (first.shape[1], first.shape[0]))
    with replacing(target, aside=_aside(target)):
        for image in chain([first], images):
            writer.write(np.ascontiguousarray(image[..., ::-1]))
        writer.release()
    return target


def _open(file: Path, fps: float, size: tuple[int, int]) -> tuple[cv2.VideoWriter, Path]:
    make_folder(file.parent)
    for codec, ending in sorted(CODECS, key=lambda known: known[1] != file.suffix.lower()):
        target = file.with_suffix(ending)
        writer = cv2.VideoWriter(str(_aside(target)), cv2.VideoWriter_fourcc(*codec), fps, size)
        if writer.isOpened():
            return writer, target
    raise OutputError(f"{file}: OpenCV can write no video here (tried {', '.join(codec for codec, _ in CODECS)})")


def _aside(file: Path) -> Path:
    return file.with_name(f"unfinished_{file.name}")
