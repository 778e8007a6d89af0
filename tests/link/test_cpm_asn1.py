"""Messages in UPER by asn1tools: with an ASN.1 text of our own every day, with ETSI's where they are at hand.

Set ETSI_CPM_ASN1 to a folder with ETSI's files (``cpm_ts103324`` with its ``cdd_ts102894_2``) for the latter.
"""

import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.errors import ConfigError, PacketError
from pcdet_avp.link.asn1_files import files_needed, with_whole_bounds
from pcdet_avp.link.cpm import CLASS_NAMES, dequantise, quantise
from pcdet_avp.link.cpm_asn1 import CpmCodec, Station
from pcdet_avp.link.cpm_bytes import SIGNERS, message_bytes, object_bits, security_bytes

asn1tools = pytest.importorskip("asn1tools", reason="asn1tools is not installed (extra 'cpm')")
OWN = Path(__file__).parent / "asn1"
ETSI = os.environ.get("ETSI_CPM_ASN1")


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(OWN, id="own"),
        pytest.param(ETSI, id="etsi", marks=pytest.mark.skipif(not ETSI, reason="set ETSI_CPM_ASN1 to ETSI's files")),
    ],
)
def codec(request):
    return CpmCodec.from_folder(Path(request.param))


def drawn(names, seed=0):
    rng, n = np.random.default_rng(seed), len(names)
    boxes = np.column_stack([rng.uniform(-50, 50, (n, 3)), rng.uniform(0.3, 6, (n, 3)), rng.uniform(-4, 4, n)])
    return quantise(boxes, names, rng.random(n), rng.uniform(-9, 9, (n, 2)), rng.permutation(60_000)[:n], -0.02)


def mixed(n):
    return [CLASS_NAMES[i % 3] for i in range(n)]


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("n", [0, 1, 3, 20, 255])
def test_what_is_encoded_comes_out_and_has_the_bytes_of_the_formula(codec, n, velocity):
    sent = drawn(mixed(n))
    payload = codec.encode(sent, velocity=velocity)
    if not velocity:
        sent["velocity"] = 16_383
    np.testing.assert_array_equal(codec.decode(payload), sent)
    assert len(payload) == message_bytes(mixed(n), velocity)


def test_the_formula_holds_from_1_to_64_cars(codec):
    objects = drawn(["Car"] * 64)
    for n in range(1, 65):
        assert len(codec.encode(objects[:n])) == message_bytes(["Car"] * n)
        assert len(codec.encode(objects[:n], velocity=False)) == message_bytes(["Car"] * n, velocity=False)


def test_a_box_with_nothing_but_out_of_range_codes_travels(codec):
    sent = quantise(np.array([[2e3, -2e3, 0, 30, 30, 30, 0.0]]), ["Car"], np.array([0.0]), np.array([[-200, 200]]))
    got = codec.decode(codec.encode(sent))
    np.testing.assert_array_equal(got, sent)
    assert not dequantise(got).placed.any()


def test_time_and_place_take_no_more_bytes_and_stand_where_x691_puts_them(codec):
    """Version 2, message 14, the station's 32 bits; then flags, 42 bits of time, 31 of latitude + 90 degrees, 32 of
    longitude + 180. The ellipse's half axes and azimuth, 12 bits each, are unavailable: it does not point to the north
    (findings/v2xflexstack_ellipse.sh)."""
    plain = codec.encode(drawn(["Car"]))
    placed = codec.encode(drawn(["Car"]), Station(0x01020304, 2**42 - 1, -90.0, -180.0))
    assert placed[:6].hex() == "020e01020304"
    bits = bin(int.from_bytes(placed, "big"))[2:].zfill(8 * len(placed))
    assert bits[48:52] == "0000"  # two extensions, two absent options
    assert bits[52:94] == "1" * 42
    assert bits[94:157] == "0" * 63
    assert [int(bits[k : k + 12], 2) for k in (157, 169, 181)] == [4095, 4095, 3601]
    assert len(placed) == len(plain)
    assert placed[20:] == plain[20:]


def test_damaged_messages_end_in_the_named_error_or_in_objects(codec):
    rng, payload = np.random.default_rng(0), codec.encode(drawn(mixed(6)))
    refused = 0
    for _ in range(150):
        damaged = bytearray(payload[: rng.integers(1, len(payload) + 1)])
        damaged[rng.integers(len(damaged))] ^= 1 << rng.integers(8)
        try:
            dequantise(codec.decode(bytes(damaged)))
        except PacketError:
            refused += 1
    assert refused > 50


def test_foreign_and_truncated_messages_are_refused(codec):
    payload = codec.encode(drawn(["Car"]))
    with pytest.raises(PacketError, match="expected message 14, found 2"):
        codec.decode(b"\x02\x02" + payload[2:])
    for short in (b"", payload[:-1], payload[:20]):
        with pytest.raises(PacketError, match="damaged or foreign"):
            codec.decode(short)


def test_values_outside_the_specification_are_not_encoded(codec):
    objects = drawn(["Car"])
    objects["yaw"] = 3602
    with pytest.raises(PacketError, match="3602"):
        codec.encode(objects)
    with pytest.raises(PacketError, match="stationId"):
        codec.encode(drawn(["Car"]), Station(-1))


def test_without_whole_bounds_a_class_takes_no_bit_and_cannot_be_read(codec):
    """Why ``with_whole_bounds`` is there; findings/asn1tools_union.sh shows it without this package."""
    modules = asn1tools.parse_files([str(file) for file in files_needed(OWN, "CPM-PDU-Descriptions")])
    plain = asn1tools.compile_dict(modules, "uper")
    vehicle = ("vehicleSubClass", 5)
    with pytest.raises(asn1tools.Error):
        plain.decode("Class", plain.encode("Class", vehicle))
    whole = asn1tools.compile_dict(with_whole_bounds(modules), "uper")
    assert whole.decode("Class", whole.encode("Class", vehicle)) == vehicle
    assert whole.encode("Class", ("vehicleSubClass", 14)).hex() == "1c"  # 0 (root), 00 (first of four), 1110, 0


@pytest.mark.parametrize(
    ("text", "value", "encoded"),
    [
        ("INTEGER (0 | 5..11 | 14)", 5, "50"),  # four bits from 0
        ("INTEGER (3 | 10..12)", 12, "90"),  # 9 in four bits
        ("INTEGER (1..2 | 7, ..., 20)", 7, "60"),  # extension bit 0, then 6 in three bits
    ],
)
def test_bounds_of_several_parts_count_from_the_least_to_the_greatest(text, value, encoded):
    modules = asn1tools.parse_string(f"M DEFINITIONS AUTOMATIC TAGS ::= BEGIN A ::= {text} END")
    whole = asn1tools.compile_dict(with_whole_bounds(modules), "uper")
    assert whole.encode("A", value).hex() == encoded


def test_what_is_missing_or_double_in_the_folder_is_named(tmp_path):
    with pytest.raises(ConfigError, match="expected a folder"):
        CpmCodec.from_folder(tmp_path / "nowhere")
    with pytest.raises(ConfigError, match="module CPM-PDU-Descriptions, found none"):
        CpmCodec.from_folder(tmp_path)
    shutil.copy(OWN / "message.asn", tmp_path)
    with pytest.raises(ConfigError, match="module Small-Values, found none"):
        CpmCodec.from_folder(tmp_path)
    for name in ("a.asn", "b.asn"):
        shutil.copy(OWN / "values" / "values.asn", tmp_path / name)
    with pytest.raises(ConfigError, match=r"module Small-Values, found a\.asn, b\.asn"):
        CpmCodec.from_folder(tmp_path)
    (tmp_path / "b.asn").unlink()
    (tmp_path / "message.asn").write_text((OWN / "message.asn").read_text().replace("SEQUENCE {", "SEQUENCE", 1))
    with pytest.raises(ConfigError, match=r"expected ETSI's ASN\.1 files of the CPM, found"):
        CpmCodec.from_folder(tmp_path)


def test_without_asn1tools_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "asn1tools", None)
    with pytest.raises(ConfigError, match=r"pip install 'pcdet_avp\[cpm\]'"):
        CpmCodec.from_folder(OWN)


def test_bits_of_a_car_by_hand():
    """15 flags, 16 id, 12 time, 1 + 3 x 30 position, 2 + 19 yaw, 3 x 13 sizes, 3 + 3 + 4 + 7 class; 2 + 2 x 22."""
    assert object_bits("Car", velocity=False) == 15 + 16 + 12 + 91 + 21 + 39 + 17 == 211
    assert object_bits("Car") == 257
    assert object_bits("Pedestrian") == object_bits("Cyclist") == 260  # 3 + 4 bits instead of 4
    assert [message_bytes(["Car"] * n) for n in (0, 1, 5, 10, 64)] == [33, 65, 194, 355, 2090]
    assert [message_bytes(["Car"] * n, velocity=False) for n in (1, 5, 10, 64)] == [59, 166, 297, 1722]
    with pytest.raises(PacketError, match="found Tram"):
        message_bytes(["Tram"])


def test_the_page_states_the_formulas_bytes():
    lines = (Path(__file__).parents[2] / "docs" / "object_message.md").read_text(encoding="utf-8").splitlines()
    cars, *rows = (
        [cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith(("| cars", "| bytes"))
    )
    assert [row[0] for row in rows] == ["bytes", "bytes without velocity"]
    for row in rows:
        stated = [int(cell.replace(",", "")) for cell in row[1:]]
        assert stated == [message_bytes(["Car"] * int(n), velocity=row[0] == "bytes") for n in cars[1:]]


def test_a_signature_by_hand():
    """In octet encoding rules; the message's length takes 1 byte below 128, 2 below 256, else 3."""
    outer, hash_id, payload, header = 1 + 1, 1, 1 + 1 + 1, 1 + 3 + 8  # flags, versions, choices; psid 639, time
    digest, signature = 1 + 8, 1 + (1 + 32) + 32
    assert security_bytes(65) == outer + hash_id + payload + 1 + header + digest + signature == 94
    assert security_bytes(355) == 96
    assert security_bytes(355, "certificate") == 96 + 3 + 139 - 9
    with pytest.raises(PacketError, match=", ".join(SIGNERS)):
        security_bytes(355, "seal")
