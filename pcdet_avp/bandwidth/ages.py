"""Age of information of a network's maps on NR-V2X: blocks as measured, 20 maps a second, both modalities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcdet_avp.link import LossModel, NrV2xChannel, NrV2xConfig
from pcdet_avp.link.age import age_at, mean_age_s
from pcdet_avp.link.nr_v2x import SLOT_S

RATE_HZ = 20
PERIOD_S = 1 / RATE_HZ
MAPS = 2400  # two minutes
LOSSES = (0.0, 0.01, 0.05, 0.2)


@dataclass(frozen=True)
class AgeRow:
    """One modality at one MCS and block loss. The age is that of the newest map of which every block arrived.

    ``closed_form_s`` is T / 2 + air time + T (1 - s) / s with the expected share s of whole maps; infinite ages, where
    hardly a map arrives whole, are None.
    """

    mcs: int
    loss: float
    modality: str
    blocks: float  # of a map, mean
    air_busy: float  # share of the slots in use
    whole_maps: float  # share of the maps that arrive whole
    mean_age_s: float | None
    p95_age_at_ticks_s: float | None
    closed_form_s: float | None


def age_rows(blocks: Mapping[int, Mapping[str, Sequence[int]]], seed: int) -> list[AgeRow]:
    """``blocks``: MCS -> modality -> blocks of each frame's map, which take turns."""
    return [row for mcs in blocks for loss in LOSSES for row in _simulate(mcs, loss, blocks[mcs], seed)]


def _simulate(mcs: int, loss: float, blocks: Mapping[str, Sequence[int]], seed: int) -> list[AgeRow]:
    link = NrV2xChannel(NrV2xConfig(mcs=mcs, loss=LossModel.independent(loss)), np.random.default_rng(seed))
    arrived: dict[tuple[str, int], list[float]] = {}
    for tick in range(MAPS):
        for modality, counts in blocks.items():
            count = counts[tick % len(counts)]
            link.send(modality, [f"{modality} {tick}".encode()] * count, tick * PERIOD_S)
        for delivery in link.receive((tick + 1) * PERIOD_S):
            modality, number = delivery.payload.decode().split()
            arrived.setdefault((modality, int(number)), []).append(delivery.arrival_s)
    busy = link.counts.blocks_sent * SLOT_S / (MAPS * PERIOD_S)
    return [_row(mcs, loss, modality, blocks, arrived, busy) for modality in blocks]


def _row(mcs, loss, modality, blocks, arrived, busy) -> AgeRow:
    counts = [blocks[modality][tick % len(blocks[modality])] for tick in range(MAPS)]
    whole = {t: arrived[modality, t][-1] for t in range(MAPS) if len(arrived.get((modality, t), ())) == counts[t]}
    captures, arrivals = np.array(list(whole)) * PERIOD_S, np.array(list(whole.values()))
    mean = p95 = None
    if len(whole) > 1:
        mean = mean_age_s(captures, arrivals, arrivals[0], arrivals[-1])
        ticks = np.arange(np.ceil(arrivals[0] / PERIOD_S), MAPS) * PERIOD_S
        p95 = float(np.quantile(age_at(ticks, captures, arrivals), 0.95))
    expected = _closed_form(loss, modality, blocks)
    return AgeRow(mcs, loss, modality, float(np.mean(counts)), busy, len(whole) / MAPS, mean, p95, expected)


def _closed_form(loss: float, modality: str, blocks: Mapping[str, Sequence[int]]) -> float | None:
    """Mean age for the mean number of blocks; the modality that is handed over second waits for the first. None if the
    air cannot carry both, or if no map arrives whole."""
    before = list(blocks)[: list(blocks).index(modality)]
    air_s = SLOT_S * sum(float(np.mean(blocks[name])) for name in (*before, modality))
    share = float(np.mean((1 - loss) ** np.array(blocks[modality], float)))
    overloaded = SLOT_S * sum(float(np.mean(counts)) for counts in blocks.values()) > PERIOD_S
    return None if share == 0 or overloaded else PERIOD_S / 2 + air_s + PERIOD_S * (1 - share) / share
