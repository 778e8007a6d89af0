"""What batch statistics cost where every iteration draws its sensors anew, against group norm.

    python benchmarks/normalisation.py [--cfg cfgs/avp/cp_tiny.yaml] [--iterations 1500] [--seeds 3]

Trains the same network from the same seed with NORM group and NORM batch, a random sensor combination per iteration,
then prints the detection loss on the test split, combination by combination. For batch norm twice: with the running
statistics that a deployed network uses, which mix all combinations, and with those of the batch itself (of one
combination), which it learned with. The difference is what mixing costs. Group norm has no statistics to mix.
The data set is made first if there is none.
"""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from pcdet_avp.config import load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches
from pcdet_avp.engine.training.run import TrainOptions, build_trainer
from pcdet_avp.engine.training.sampler import CombinationBatchSampler
from pcdet_avp.generate import generate
from pcdet_avp.structures.sensor_set import SENSOR_SETS

EVALUATION_BATCH = 4


def trained(cfg, norm: str, seed: int, iterations: int) -> nn.Module:
    cfg.MODEL.NORM = norm
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=True)
    cfg.OPTIMIZATION.NUM_EPOCHS = -(-iterations // (len(dataset) // cfg.OPTIMIZATION.BATCH_SIZE_PER_GPU))
    ranks = Ranks(torch.device("cpu"))
    trainer = build_trainer(cfg, dataset, TrainOptions(seed=seed), ranks, logging.getLogger("quiet"))
    source = batches(dataset, CombinationBatchSampler(trainer.plan), ranks)
    for _ in tqdm(range(trainer.planned), desc=f"{norm}, seed {seed}", leave=False):
        trainer.step(next(source))
    return trainer.model


def losses(network: nn.Module, cfg, running: bool) -> dict[str, float]:
    """Mean detection loss over the test split by combination; ``running``: batch norms use their running statistics."""
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False)
    network.train()
    network.map_dropout = network.segment_dropout = 0.0
    for module in network.modules():
        if isinstance(module, nn.modules.batchnorm._BatchNorm):
            module.train(not running)
            module.momentum = 0.0  # looking changes nothing
    indices = [range(i, i + EVALUATION_BATCH) for i in range(0, len(dataset) - EVALUATION_BATCH + 1, EVALUATION_BATCH)]
    found = {}
    with torch.no_grad():
        for combo in SENSOR_SETS:
            sampler = [[(index, combo) for index in part] for part in indices]
            parts = [network(batch)[1]["rpn_loss"] for batch in batches(dataset, sampler, Ranks(torch.device("cpu")))]
            found[combo] = float(np.mean([float(part) for part in parts]))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", default="cfgs/avp/cp_tiny.yaml")
    parser.add_argument("--iterations", type=int, default=1500)
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    cfg = load_config(args.cfg)
    if not (Path(cfg.DATA_CONFIG.DATA_PATH) / MANIFEST_FILE).exists():
        generate(cfg.DATA_CONFIG, Path(cfg.DATA_CONFIG.DATA_PATH))
    rows: dict[str, list[list[float]]] = {"group": [], "batch, running": [], "batch, of the batch": []}
    for seed in range(args.seeds):
        rows["group"].append(list(losses(trained(cfg, "group", seed, args.iterations), cfg, True).values()))
        network = trained(cfg, "batch", seed, args.iterations)
        rows["batch, running"].append(list(losses(network, cfg, True).values()))
        rows["batch, of the batch"].append(list(losses(network, cfg, False).values()))
    print(f"detection loss on the test split of {Path(args.cfg).stem}, mean of {args.seeds} seeds (standard deviation)")
    print(f"{'':<22}" + "".join(f"{combo:>14}" for combo in SENSOR_SETS))
    for name, values in rows.items():
        columns = zip(np.mean(values, 0), np.std(values, 0), strict=True)
        print(f"{name:<22}" + "".join(f"{mean:>7.3f} ({std:.3f})" for mean, std in columns))


if __name__ == "__main__":
    main()
