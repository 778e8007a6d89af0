"""Pictures come back as they were; JPEG and other writers' PNG are read; what is cut short is refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pcdet_avp.datasets.avp.image_files import decode_depth, decode_image, encode_depth, encode_image
from pcdet_avp.errors import RecordError

FILE = Path("ego_camera.png")
shapes = st.tuples(st.integers(1, 40), st.integers(1, 40))


@given(image=shapes.flatmap(lambda s: hnp.arrays(np.uint8, (*s, 3))))
@settings(max_examples=30, deadline=None)
def test_an_image_survives(image):
    np.testing.assert_array_equal(decode_image(encode_image(image), FILE), image)


@given(mm=shapes.flatmap(lambda s: hnp.arrays(np.uint16, s)))
@settings(max_examples=30, deadline=None)
def test_whole_millimetres_survive(mm):
    depth = mm.astype(np.float32) * np.float32(0.001)
    np.testing.assert_array_equal(decode_depth(encode_depth(depth), FILE), depth)


def smooth_image():
    v, u = np.mgrid[:60, :80]
    return np.stack([u * 3, v * 4, u + v], -1).astype(np.uint8)


def test_a_jpeg_is_read_in_the_right_colours():
    data = cv2.imencode(".jpg", smooth_image()[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    difference = decode_image(data, FILE).astype(int) - smooth_image()
    assert np.abs(difference).mean() < 2


@pytest.mark.parametrize("kind", [".png", ".jpg"])
@given(share=st.floats(0.0, 0.999))
@settings(max_examples=30, deadline=None)
def test_a_picture_cut_anywhere_is_refused(kind, share):
    data = cv2.imencode(kind, smooth_image())[1].tobytes()
    with pytest.raises(RecordError, match=r"ego_camera.png: "):
        decode_image(data[: int(share * len(data))], FILE)


@given(at=st.integers(8, 10_000), bit=st.integers(0, 7))
@settings(max_examples=60, deadline=None)
def test_any_flipped_bit_of_a_png_is_refused_without_a_checksum_of_ours(at, bit):
    data = bytearray(encode_image(smooth_image()))
    data[8 + at % (len(data) - 8)] ^= 1 << bit
    with pytest.raises(RecordError, match=r"ego_camera.png: "):
        decode_image(bytes(data), FILE)


def test_grey_and_transparent_pictures_become_rgb():
    grey = np.full((4, 6), 77, np.uint8)
    assert (decode_image(cv2.imencode(".png", grey)[1].tobytes(), FILE) == 77).all()
    with_alpha = np.full((4, 6, 4), 99, np.uint8)
    assert decode_image(cv2.imencode(".png", with_alpha)[1].tobytes(), FILE).shape == (4, 6, 3)


def test_an_8_bit_depth_map_is_refused():
    with pytest.raises(RecordError, match=r"one 16-bit channel, found uint8"):
        decode_depth(cv2.imencode(".png", np.ones((4, 6), np.uint8))[1].tobytes(), FILE)


def test_another_file_type_is_refused():
    with pytest.raises(RecordError, match="neither PNG nor JPEG"):
        decode_image(cv2.imencode(".bmp", smooth_image())[1].tobytes(), FILE)


def jpeg(*flags):
    return cv2.imencode(".jpg", smooth_image()[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90, *flags])[1].tobytes()


PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
RESTARTS = (cv2.IMWRITE_JPEG_RST_INTERVAL, 2)
THUMBNAIL = b"\xff\xe1" + (2 + 8).to_bytes(2, "big") + b"ab\xff\xd9cdef"  # an end marker inside a segment
EXTRAS = [b"\0" * 1000, b"\xff" * 100, b"comment", b"\xff\xd8\xff\xe0 a second picture"]


@pytest.mark.parametrize("flags", [(), PROGRESSIVE, RESTARTS])
@pytest.mark.parametrize("extra", EXTRAS)
def test_what_stands_behind_the_end_of_a_picture_is_harmless(flags, extra):
    plain, png = jpeg(*flags), encode_image(smooth_image())
    np.testing.assert_array_equal(decode_image(plain + extra, FILE), decode_image(plain, FILE))
    np.testing.assert_array_equal(decode_image(png + extra, FILE), smooth_image())
    depth = encode_depth(np.ones((4, 6)))
    np.testing.assert_array_equal(decode_depth(depth + extra, FILE), np.ones((4, 6), np.float32))


@pytest.mark.parametrize("flags", [(), PROGRESSIVE, RESTARTS])
@pytest.mark.parametrize("padding", [b"", b"\0" * 5000])
def test_a_cut_jpeg_is_refused_although_it_is_padded_or_its_thumbnail_has_an_end(flags, padding):
    whole = jpeg(*flags)
    whole = whole[:2] + THUMBNAIL + whole[2:]
    decode_image(whole, FILE)
    for keep in (20, len(whole) // 2, len(whole) - 2):
        with pytest.raises(RecordError, match="truncated JPEG"):
            decode_image(whole[:keep] + padding, FILE)


def test_fill_bytes_between_segments_are_read():
    whole = jpeg()
    at = whole.index(b"\xff\xda")
    decode_image(whole[:at] + b"\xff\xff" + whole[at:], FILE)
