"""Bytes of roadside maps of the paper's size, everything counted, from frames rendered at the paper's size.

    python benchmarks/full_size_bytes.py                                            cp_full, random weights
    python benchmarks/full_size_bytes.py --ckpt F                                   cp_full, trained
    python benchmarks/full_size_bytes.py --cfg cfgs/avp/cp_small.yaml --ckpt F      cp_small's weights on full-size
                                                                                    frames: 4 channels instead of 8

Each frame is the first of another scene of ``--data_cfg``, seen by the mast's camera and LiDAR. Every map is written as
the network makes it, and with rate control at ``--budget`` (default: the paper's 72 KB, scaled to the channels).
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from pcdet_avp.bandwidth.ages import age_rows
from pcdet_avp.bandwidth.plan import Transmission, paper_budget_bytes
from pcdet_avp.bandwidth.transmit import segments_of, sent_of
from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.datasets.avp.prepare import PrepareConfig, prepare
from pcdet_avp.generate import plan, scene_config
from pcdet_avp.link import NrV2xConfig
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.link.nr_v2x import BYTES_PER_SLOT
from pcdet_avp.link.precision import PRECISIONS
from pcdet_avp.models import build_network
from pcdet_avp.models.detectors.split_inference import latent_shape
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.sensor_set import SensorSet, modality_of

ROADSIDE = SensorSet(False, False, True, True)


def build(cfg, data_cfg, ckpt: Path | None) -> nn.Module:
    """The configured network on the grid of ``data_cfg``."""
    network_input = NetworkInput.from_config(data_cfg, cfg.CLASS_NAMES)
    torch.manual_seed(0)
    model = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), network_input).eval()
    if ckpt is not None:
        model.load_params_from_file(str(ckpt), logging.getLogger("full_size_bytes"), to_cpu=True)
    return model


def roadside_batches(cfg, data_cfg, frames: int) -> Iterator[dict]:
    """What the mast sees at the beginning of each of the first scenes, as the network takes it."""
    settings, config = plan(data_cfg).generator["GENERATE"], PrepareConfig.from_config(data_cfg, cfg.CLASS_NAMES)
    rig = Rig.from_config(data_cfg.SENSORS)
    for number in tqdm(range(frames), unit="frame", desc="rendering and encoding"):
        rng = np.random.default_rng(np.random.SeedSequence([settings["SEED"], number]))
        scene = draw_training_scene(rng, scene_config(settings))
        key, frame_id = (settings["SEED"], number, 0), f"{number:04d}/000"
        frame = capture(scene.seek(0), rig, key, frame_id, sources=ROADSIDE.sources)
        yield load_batch(collate([prepare(frame, ROADSIDE, config)]), "cpu")


def latents_of(model: nn.Module, batch_dict: dict) -> dict[str, Tensor]:
    """modality -> (c, h, w)."""
    with torch.no_grad():
        latents = model.encode_roadside(batch_dict)
    return {modality_of(source): latent.values[0] for source, latent in latents.items()}


def print_table(latents: list[dict[str, Tensor]], budget: int, room: int) -> None:
    """A line per way to write the maps, and modality."""
    head = ("median", "95 %", "most", "blocks", "sparsity")
    print(f"{'':34}{'map':8}" + "".join(f"{name:>10}" for name in head))
    ways = {f"{p}, as the network makes it": Transmission(p) for p in PRECISIONS}
    ways |= {
        f"{p}, at most {b:,} B": Transmission(p, size=MapSize(b))
        for p, b in (("float16", budget), ("int8", budget // 2))
    }
    for label, way in ways.items():
        for modality in latents[0]:
            sent = [sent_of(segments_of(of_frame[modality], modality, way, room)) for of_frame in latents]
            sizes, blocks = [s.bytes for s in sent], np.mean([s.blocks for s in sent])
            numbers = (np.median(sizes), np.quantile(sizes, 0.95), max(sizes))
            sparsity = 1 - np.mean([s.occupied for s in sent])
            print(
                f"{label:34}{modality:8}" + "".join(f"{n:10,.0f}" for n in numbers) + f"{blocks:10.1f}{sparsity:10.3f}"
            )


def print_ages(latents: list[dict[str, Tensor]], precision: str) -> None:
    """Share of air time that both modalities take at 20 Hz without loss, and age of the newest whole map."""
    print(f"\n{precision} at 20 Hz: " + "".join(f"{name:>14}" for name in ("air busy", "camera age", "lidar age")))
    for mcs in BYTES_PER_SLOT:
        room, way = NrV2xConfig(mcs=mcs).max_segment_bytes, Transmission(precision)
        blocks = {m: [len(segments_of(of[m], m, way, room)) for of in latents] for m in latents[0]}
        rows = [row for row in age_rows({mcs: blocks}, seed=0) if row.loss == 0]
        ages = "".join(f"{1e3 * row.mean_age_s:11.1f} ms" if row.mean_age_s else f"{'none':>14}" for row in rows)
        print(f"MCS {mcs:<3}{'':>{len(precision) + 4}}{100 * rows[0].air_busy:12.1f} %{ages}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", default="cfgs/avp/cp_full.yaml")
    parser.add_argument("--ckpt", type=Path)
    parser.add_argument("--data_cfg", default="cfgs/dataset_configs/avp_full.yaml")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--budget", type=int)
    parser.add_argument("--mcs", type=int, default=21)
    args = parser.parse_args()
    cfg, data_cfg = load_config(args.cfg), load_config(args.data_cfg)
    model = build(cfg, data_cfg, args.ckpt)
    shape = latent_shape(model)
    latents = [latents_of(model, batch) for batch in roadside_batches(cfg, data_cfg, args.frames)]
    weights = "random weights (no training)" if args.ckpt is None else f"weights {args.ckpt.name}"
    print(f"\n{Path(args.cfg).stem}, {weights}, {args.frames} frames of {Path(args.data_cfg).stem}: maps of {shape}")
    print_table(latents, args.budget or paper_budget_bytes(shape), NrV2xConfig(mcs=args.mcs).max_segment_bytes)
    for precision in PRECISIONS:
        print_ages(latents, precision)


if __name__ == "__main__":
    main()
