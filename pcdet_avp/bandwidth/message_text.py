"""The section of the report about the object-level message."""

from __future__ import annotations

from collections.abc import Mapping

from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.link.cpm_bytes import SENSOR_CONTAINER_BYTES, TRANSPORT_BYTES, security_bytes

SHOWN = (1, 2, 5, 10, 20, 40, 64)
LONG = 256  # a message from which on a signature's bytes are constant


def message_text(content: Mapping) -> str:
    """Markdown: bytes of the frames' messages, bytes by the number of cars, AP before and after quantisation."""
    message = content["message"]
    title = f"## Object-level message, ETSI CPM ({content['config']})"
    if not message:
        return f"{title}\n\nNo figures: a class of this configuration has no code in the message."
    parts = [title, _sizes(message), _cars(message), _overheads()]
    if content["quantisation"]:
        parts.append(_quantisation(content))
    return "\n\n".join(parts)


def _sizes(message: Mapping) -> str:
    texts = {"all_boxes": "every box that the roadside finds", "driving_boxes": "those above the driving score"}
    header = ["", "boxes, median", "median B", "95 % B", "median B without velocity", "95 % B without velocity"]
    body = []
    for key in (key for key in texts if key in message):
        row, bare = message[key], message[key]["without_velocity"]
        numbers = (row["objects"], row["median"], row["p95"], bare["median"], bare["p95"])
        body.append([texts[key], *(f"{number:,.0f}" for number in numbers)])
    how = "encoded in UPER, decoded and compared" if message["encoded"] else "by the formula; `--cpm_asn1` encodes them"
    left = (
        f"{message['beyond_range']} boxes of all frames lie beyond the coded ranges and cannot be placed by a receiver."
    )
    lines = [
        f"A frame's message of {message['combo']}'s roadside with every box, {how}.",
        "Our boxes have no velocity; its field is coded unavailable.",
        left,
    ]
    return "\n".join([*lines, "", *markdown_table(header, body)])


def _cars(message: Mapping) -> str:
    header = ["cars", "formula B", "formula B without velocity"]
    keys = ["formula", "formula_without_velocity"]
    if message["encoded"]:
        header, keys = (
            [*header, "encoded B", "encoded B without velocity"],
            [*keys, "encoded", "encoded_without_velocity"],
        )
    rows = {row["objects"]: row for row in message["cars"]}
    lines = markdown_table(header, [[str(n), *(f"{rows[n][key]:,}" for key in keys)] for n in SHOWN])
    if message["encoded"]:
        pairs = [(row[key], row[f"encoded{key[7:]}"]) for row in rows.values() for key in keys[:2]]
        worst = max(abs(formula - encoded) for formula, encoded in pairs)
        lines = [*lines, "", f"Over 1 to {len(rows)} cars formula and encoding differ by at most {worst} B."]
    return "\n".join(lines)


def _overheads() -> str:
    digest, certificate = (security_bytes(LONG, signer) for signer in ("digest", "certificate"))
    lines = [
        f"Not counted: a signature (ETSI TS 103 097) adds {digest} B, or {certificate} B with its certificate,",
        f"about once a second; a sensor container for two sensors {SENSOR_CONTAINER_BYTES} B, about once a second;",
        f"GeoNetworking and BTP {TRANSPORT_BYTES} B.",
    ]
    return "\n".join(lines)


def _quantisation(content: Mapping) -> str:
    header = [
        "late fusion, AP at the strict IoU",
        "class",
        "before quantisation",
        "after",
        "difference",
        "95 % interval",
    ]
    body = []
    for row in content["quantisation"]:
        gain = row["gain"]
        shown = ["-" if row[key] is None else f"{row[key]:.1f}" for key in ("before", "after")]
        ends = ["-", "-"] if gain is None else [f"{gain['points']:+.2f}", f"[{gain['low']:+.2f}, {gain['high']:+.2f}]"]
        body.append([row["combo"], row["class"], *shown, *ends])
    return "\n".join(markdown_table(header, body))
