"""``bandwidth.json``, ``report.md`` and the plots."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pcdet_avp.bandwidth.ages import age_rows
from pcdet_avp.bandwidth.message_text import message_text
from pcdet_avp.bandwidth.messages import message_rows, quantisation_rows
from pcdet_avp.bandwidth.plots import write_plots
from pcdet_avp.bandwidth.rows import Evaluator, blocks_by_mcs, map_rows, point_rows
from pcdet_avp.bandwidth.study import Study
from pcdet_avp.evaluation.average_precision import LOOSE_IOU, STRICT_IOU
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.files import write_json, write_text
from pcdet_avp.link.cpm_asn1 import CpmCodec

SECTIONS = {
    "Maps against bytes": (("reference", "codec", "budget", "objects"), "ap_bytes.png"),
    "Block loss": (("reference", "loss"), "ap_loss.png"),
    "Pose error": (("reference", "pose"), "ap_pose.png"),
}


def make_content(
    study: Study, dataset: Any, min_scores: Mapping[str, float] | None, meta: Mapping, codec: CpmCodec | None = None
) -> dict:
    """Everything that the report says, as plain values; ``meta`` as from ``provenance``. With a ``codec``, object-level
    messages are encoded for real."""
    options, evaluator = study.options, Evaluator.of(dataset, study)
    rows = point_rows(study, evaluator)
    about = {"split": dataset.split, "frames": len(study.chosen), "every": options.every, "mcs": options.mcs}
    about |= {"precision": study.precision, "latent_shape": study.latent_shape, "budget_bytes": study.budget_bytes}
    about |= {"max_bytes": study.size.max_bytes, "constant_size": study.size.constant}
    return {
        "meta": {**meta, **about, "study_seed": options.seed},
        "config": meta["config"],
        "combos": list(options.combos),
        "maps": map_rows(study),
        "message": message_rows(study, dataset.class_names, min_scores, codec),
        "quantisation": quantisation_rows(study, evaluator, rows),
        "rows": rows,
        "ages": [asdict(row) for row in age_rows(blocks_by_mcs(study), options.seed)],
    }


def write_report(content: Mapping, folder: Path, logger: logging.Logger) -> None:
    """The numbers first, then the plots, then the page again with them; a plot that fails is named in the log."""
    write_json(folder / "bandwidth.json", content)
    write_text(folder / "report.md", report_text(content, []))
    write_text(folder / "report.md", report_text(content, write_plots(content, folder, logger)))


def report_text(content: Mapping, plots: Sequence[str]) -> str:
    """The page, markdown."""
    parts = [f"# Bandwidth report of {content['config']}", _about(content), _bytes(content)]
    parts += [_picture("bytes.png", plots), message_text(content)]
    studies = {row["study"] for row in content["rows"]}
    for title, (wanted, picture) in SECTIONS.items():
        if studies & set(wanted[1:]):
            parts += [f"## {title} ({content['config']})", *_tables(content, wanted), _picture(picture, plots)]
    parts += [_ages(content), _picture("age.png", plots), _notes(content)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _picture(name: str, plots: Sequence[str]) -> str:
    return f"![{name.partition('.')[0]}]({name})" if name in plots else ""


def _about(content: Mapping) -> str:
    meta, (c, h, w) = content["meta"], content["meta"]["latent_shape"]
    overlaps = ", ".join(f"{name} {strict:g}/{LOOSE_IOU:g}" for name, strict in STRICT_IOU.items())
    lines = [
        f"`{meta['command']}`",
        "",
        f"Checkpoint {meta['checkpoint']} (weights {meta['weights_hash']}), {meta['frames']} frames of split",
        f"{meta['split']}. A map on the air is {c} x {h} x {w}, {2 * c * h * w:,} B dense in float16; the budget is",
        f"{meta['budget_bytes']:,} B a map. Segments are cut for MCS {meta['mcs']}.",
        *_limit(meta),
        f"AP is 3D AP (%, R40) at the strict/loose IoU ({overlaps}), all difficulties,",
        f"region {_first_region(content)}; in brackets the difference at the strict IoU and its 95 % interval, paired",
        "over scenes.",
    ]
    return "\n".join(lines)


def _limit(meta: Mapping) -> list[str]:
    """What MODEL.COMPRESSION says of the bytes of a map on the air."""
    if meta.get("max_bytes") is None:
        return []
    filled = ", and filled up to that size where one block carries it" if meta["constant_size"] else ""
    return [f"As trained, a map is held to {meta['max_bytes']:,} B by dropping its shortest cells{filled}."]


def _first_region(content: Mapping) -> str:
    return next(iter(content["rows"][0]["ap"]))


def _bytes(content: Mapping) -> str:
    header = ["", "map", "median B", "95 % B", "least B", "most B", "blocks", "Mbit/s at 20 Hz", "sparsity"]
    shown = [row for row in content["maps"] if row["study"] in ("reference", "codec", "budget")]
    body = [
        [row["label"], row["modality"], *(f"{row[key]:,.0f}" for key in ("median", "p95", "min", "max"))]
        + [f"{row['blocks']:.1f}", f"{row['mbit_per_s']:.2f}", f"{row['sparsity']:.3f}"]
        for row in shown
    ]
    lines = [f"## Bytes per map, everything counted ({content['config']})", "", *markdown_table(header, body)]
    return "\n".join(lines)


def _tables(content: Mapping, studies: Sequence[str]) -> Iterator[str]:
    names = list(next(iter(content["rows"][0]["ap"].values())))
    of_bytes = "budget" in studies
    last = ["B per frame", "against"] if of_bytes else ["same as the vehicle alone"]
    for combo in content["combos"]:
        rows = [row for row in content["rows"] if row["combo"] == combo and row["study"] in studies]
        header = [combo, *(f"{name} AP" for name in names), *last]
        yield "\n".join(markdown_table(header, [_line(row, names, of_bytes) for row in rows]))


def _line(row: Mapping, names: Sequence[str], of_bytes: bool) -> list[str]:
    """A reference is held against uncompressed maps only where bytes are what counts."""
    sent, with_gain = row["bytes_per_frame"], of_bytes or row["study"] != "reference"
    first = [row["label"], *(_cell(row, name, with_gain) for name in names)]
    if not of_bytes:
        return [*first, "yes" if row["same_as_alone"] else "no"]
    return [*first, "" if sent is None else f"{sent:,.0f}", row["held_against"] or ""]


def _cell(row: Mapping, name: str, with_gain: bool) -> str:
    cells = next(iter(row["ap"].values()))[name]["overall"]
    values = [cells[f"{overlap:g}"] for overlap in (STRICT_IOU[name], LOOSE_IOU)]
    text, gain = "/".join("-" if value is None else f"{value:.1f}" for value in values), row["gain"][name]
    return (
        text
        if gain is None or not with_gain
        else f"{text} ({gain['points']:+.1f} [{gain['low']:+.1f}, {gain['high']:+.1f}])"
    )


def _ages(content: Mapping) -> str:
    header = [
        "MCS",
        "block loss",
        "map",
        "blocks",
        "air busy",
        "arrive whole",
        "mean age",
        "closed form",
        "95 % at ticks",
    ]
    body = [
        [str(row["mcs"]), f"{100 * row['loss']:g} %", row["modality"], f"{row['blocks']:.1f}"]
        + [f"{100 * row[key]:.1f} %" for key in ("air_busy", "whole_maps")]
        + [_ms(row[key]) for key in ("mean_age_s", "closed_form_s", "p95_age_at_ticks_s")]
        for row in content["ages"]
    ]
    title = f"## Age of the newest whole map at 20 Hz ({content['config']})"
    return "\n".join([title, "", *markdown_table(header, body)])


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1e3 * seconds:.1f} ms"


def _notes(content: Mapping) -> str:
    own = content["meta"]["precision"]
    return f"""## What is compared

- "not thinned, not rounded": the same weights, the compressed map (C / 8 channels, half the size) sent as float32 with
  every cell. It is what these weights would see on a link without limits, not a network trained without compression.
- {own} is what the weights were trained for; the other precision is rounded to after training.
- A budget is held for every map by dropping its shortest cells until all bytes fit, one budget for each of the maps.
- Block loss: each frame stands alone. The vehicle uses what arrived of this frame's maps and has no older ones; one
  random number decides about a block at every loss, so that what is lost at 5 % is lost at 20 %, too.
- Pose error: normal, of the vehicle's own pose (both axes, heading), the same directions at every size.
- Boxes: what the same network finds from the maps of the combination's roadside sensors alone, in the vehicle's frame
  and within the roadside's range, merged with the vehicle's own by the network's suppression within each class. The
  network was trained with at least one of the vehicle's sensors; a detector trained for the roadside may do better.
  All boxes are sent, since AP judges a ranking; their message is longer than one to drive with. "boxes (late fusion)"
  merges what comes out of the message, "boxes, not quantised" what would have gone in.
- Delay: the frames of a data set are too far apart for it; `benchmarks/delay.py` renders the roadside earlier, and the
  closed loop drives with it."""
