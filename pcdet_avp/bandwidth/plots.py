"""Plots of the bandwidth report, each with the configuration's name in its title."""

from __future__ import annotations

import io
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.files import write_bytes
from pcdet_avp.visualization.palette import CLASS_INKS, MODALITY_INKS


def write_plots(content: Mapping, folder: Path, logger: logging.Logger) -> list[str]:
    """Write those plots whose studies are there; their file names. One that cannot be drawn is named in the log."""
    written = []
    for name, draw in _figures(content):
        try:
            _save(draw(content), folder / name)
        except Exception as error:  # whatever goes wrong in a picture: the numbers, and the other pictures, stand
            logger.warning("%s: this plot could not be drawn (%s: %s)", folder / name, type(error).__name__, error)
            continue
        written.append(name)
    return written


def _figures(content: Mapping) -> Iterator[tuple[str, Callable[[Mapping], plt.Figure]]]:
    studies = {row["study"] for row in content["rows"]}
    yield "bytes.png", bytes_histogram
    if studies & {"codec", "budget", "objects"}:
        yield "ap_bytes.png", ap_against_bytes
    if "loss" in studies:
        yield "ap_loss.png", ap_against_loss
    if "pose" in studies:
        yield "ap_pose.png", ap_against_pose
    yield "age.png", age_bars


def _save(figure: plt.Figure, file: Path) -> None:
    picture = io.BytesIO()
    figure.savefig(picture, dpi=120, format="png", bbox_inches="tight")
    plt.close(figure)
    write_bytes(file, picture.getvalue())


def ap_of(row: Mapping, name: str) -> float:
    """AP of a class at its strict overlap, all difficulties, first region; NaN where nothing had to be found."""
    first = next(iter(row["ap"].values()))
    value = first[name]["overall"][f"{STRICT_IOU[name]:g}"]
    return np.nan if value is None else value


def _pick(content: Mapping, combo: str, *studies: str) -> list[dict]:
    return [row for row in content["rows"] if row["combo"] == combo and row["study"] in studies]


def _classes(content: Mapping) -> list[str]:
    return list(next(iter(content["rows"][0]["ap"].values())))


def bytes_histogram(content: Mapping) -> plt.Figure:
    """Histogram of map sizes, as trained and in the other precision."""
    rows = [row for row in content["maps"] if row["study"] == "reference" or "not trained for" in row["label"]]
    labels = list(dict.fromkeys(row["label"] for row in rows))
    figure, axes = plt.subplots(1, len(labels), figsize=(5.2 * len(labels), 3.4), squeeze=False, sharex=True)
    edges = np.linspace(0, 1.02 * max(max(row["sizes"]) for row in rows), 41)
    for ax, label in zip(axes[0], labels, strict=True):
        for row in (r for r in rows if r["label"] == label):
            text = f"{row['modality']}: median {row['median']:,.0f} B, 95 % {row['p95']:,.0f} B"
            ax.hist(row["sizes"], edges, alpha=0.6, color=MODALITY_INKS[row["modality"]], label=text)
        ax.set(title=f"{content['config']}: {label}", xlabel="bytes per map, everything counted", ylabel="maps")
        ax.legend(fontsize=8)
    return figure


def ap_against_bytes(content: Mapping) -> plt.Figure:
    """One panel per combination; bytes of both maps together."""
    figure, axes = _panels(content)
    for ax, combo in zip(axes, content["combos"], strict=True):
        for name in _classes(content):
            color = CLASS_INKS[name]
            budgets = _pick(content, combo, "budget")
            for line, precision in (("-", "float16"), ("--", "int8")):
                chosen = sorted(
                    (r["bytes_per_frame"], ap_of(r, name)) for r in budgets if r["label"].startswith(precision)
                )
                if chosen:
                    ax.plot(
                        *zip(*chosen, strict=True), line, color=color, marker="o", ms=4, label=f"{name}, {precision}"
                    )
            for row, marker, text in _marked(content, combo):
                ax.plot(row["bytes_per_frame"], ap_of(row, name), marker, color=color, ms=9, label=f"{name}, {text}")
            alone = _pick(content, combo, "reference")[0]
            ax.axhline(ap_of(alone, name), color=color, ls=":", lw=1, label=f"{name}, vehicle alone")
        ax.set(xscale="log", xlabel="bytes per frame, all maps, everything counted")
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
        ax.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
    return _finished(figure, axes, content, "AP against bytes")


def _marked(content: Mapping, combo: str) -> Iterator[tuple[dict, str, str]]:
    yield _pick(content, combo, "reference")[1], "*", "as trained"
    for row in _pick(content, combo, "objects"):
        if row["bytes_per_frame"] is not None:
            yield row, "X", "boxes (late fusion)"


def ap_against_loss(content: Mapping) -> plt.Figure:
    """One panel per combination; dotted: the vehicle alone."""
    figure, axes = _panels(content)
    for ax, combo in zip(axes, content["combos"], strict=True):
        alone, sent = _pick(content, combo, "reference")[:2]
        rows = [(0.0, sent), *((float(r["label"].split()[0]), r) for r in _pick(content, combo, "loss"))]
        for name in _classes(content):
            x, y = zip(*((loss, ap_of(row, name)) for loss, row in rows), strict=True)
            ax.plot(x, y, color=CLASS_INKS[name], marker="o", ms=4, label=name)
            ax.axhline(ap_of(alone, name), color=CLASS_INKS[name], ls=":", lw=1, label=f"{name}, vehicle alone")
        ax.set(xlabel="blocks lost (%)")
    return _finished(figure, axes, content, "AP against block loss")


def ap_against_pose(content: Mapping) -> plt.Figure:
    """Two panels: error in position and in heading."""
    figure, axes = plt.subplots(1, 2, figsize=(10.4, 3.6), sharey=True)
    for ax, unit, text in zip(axes, ("m", "deg"), ("position (m, per axis)", "heading (degrees)"), strict=True):
        for line, combo in zip(("-", "--", "-.", ":"), content["combos"], strict=False):
            sent = _pick(content, combo, "reference")[1]
            rows = [r for r in _pick(content, combo, "pose") if r["label"].split()[1] == unit]
            rows = [(0.0, sent), *((float(r["label"].split()[0]), r) for r in rows)]
            for name in _classes(content):
                x, y = zip(*((std, ap_of(row, name)) for std, row in rows), strict=True)
                ax.plot(x, y, line, color=CLASS_INKS[name], marker="o", ms=4, label=f"{name}, {combo}")
        ax.set(xlabel=f"standard deviation of the vehicle's own {text}")
    return _finished(figure, list(axes), content, "AP against pose error")


def age_bars(content: Mapping) -> plt.Figure:
    """Mean age of the newest whole map, by MCS and block loss."""
    figure, axes = plt.subplots(1, 2, figsize=(10.4, 3.4), sharey=True)
    for ax, modality in zip(axes, ("camera", "lidar"), strict=True):
        rows = [row for row in content["ages"] if row["modality"] == modality]
        losses = sorted({row["loss"] for row in rows})
        for k, loss in enumerate(losses):
            at = [row for row in rows if row["loss"] == loss]
            x = np.arange(len(at)) + (k - (len(losses) - 1) / 2) * 0.8 / len(losses)
            height = [1e3 * row["mean_age_s"] if row["mean_age_s"] else np.nan for row in at]
            ax.bar(x, height, 0.8 / len(losses), label=f"{100 * loss:g} % of the blocks lost")
            ax.set_xticks(range(len(at)), [f"MCS {row['mcs']}" for row in at])
        ax.set(title=f"{content['config']}: age of the newest whole {modality} map")
    axes[0].set_ylabel("mean age (ms)")
    axes[0].legend(fontsize=8)
    return figure


def _panels(content: Mapping) -> tuple[plt.Figure, Sequence]:
    count = len(content["combos"])
    figure, axes = plt.subplots(1, count, figsize=(5.2 * count, 3.8), squeeze=False)
    return figure, list(axes[0])


def _finished(figure: plt.Figure, axes: Sequence, content: Mapping, title: str) -> plt.Figure:
    for ax, combo in zip(axes, content["combos"], strict=False):
        ax.grid(alpha=0.3)
        if len(axes) == len(content["combos"]) and "pose" not in title:
            ax.set_title(f"{content['config']}, {combo}", fontsize=10)
    strict = ", ".join(f"{name} {STRICT_IOU[name]:g}" for name in _classes(content))
    axes[0].set_ylabel(f"3D AP (%), IoU {strict}")
    axes[-1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1.01, 0.5), handlelength=4)
    figure.suptitle(f"{content['config']}: {title}", fontsize=11)
    return figure
