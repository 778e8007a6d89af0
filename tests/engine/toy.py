"""A toy network and data set with the interfaces of the real ones, small enough to train in milliseconds."""

import logging

import numpy as np
import torch
from torch import nn

from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches
from pcdet_avp.engine.training.sampler import BatchPlan, CombinationBatchSampler
from pcdet_avp.engine.training.trainer import Trainer

OPTIMIZATION = {
    "OPTIMIZER": "adam_onecycle",
    "LR": 0.01,
    "WEIGHT_DECAY": 0.01,
    "MOMS": [0.95, 0.85],
    "PCT_START": 0.4,
    "DIV_FACTOR": 10,
    "GRAD_NORM_CLIP": 10,
}


class ToyNetwork(nn.Module):
    """One linear encoder for the camera, one for the LiDAR, a bare parameter that scales their sum, and dropout."""

    def __init__(self):
        super().__init__()
        self.camera, self.lidar = nn.Linear(4, 3), nn.Linear(4, 3)
        self.scale = nn.Parameter(torch.ones(3))
        self.dropout = nn.Dropout(0.5)

    def forward(self, batch_dict):
        x = batch_dict["points"]
        out = self.camera(x)
        if batch_dict["source_present"][0, 1]:
            out = out + self.lidar(x)
        loss = (self.dropout(out * self.scale) - 1).square().mean() * batch_dict.get("loss_factor", 1.0)
        return {"loss": loss}, {"rpn_loss": loss.detach()}, {}


class ToyDataset(torch.utils.data.Dataset):
    """Sample (i, combo, epoch) is four numbers that depend on i and, as an augmentation would, on the epoch."""

    def __len__(self):
        return 10

    def __getitem__(self, key):
        index, combo, epoch = key
        points = np.random.default_rng((index, epoch)).standard_normal(4, np.float32)
        return {"points": points, "present": [True, combo.startswith("CL")]}

    @staticmethod
    def collate_batch(samples):
        points, present = (np.stack([s[key] for s in samples]) for key in ("points", "present"))
        return {"batch_size": len(samples), "points": points, "source_present": present}


def make_trainer(planned=30, ranks=None, seed=3, dropout=0.5, **changes):
    torch.manual_seed(0)
    model = ToyNetwork()
    model.dropout.p = dropout
    ranks = ranks or Ranks(torch.device("cpu"))
    return Trainer(model, OPTIMIZATION | changes, BatchPlan(len(ToyDataset()), 4, seed), planned, ranks)


def make_batches(trainer, workers=0):
    sampler = CombinationBatchSampler(trainer.plan, trainer.iteration, trainer.ranks.rank, trainer.ranks.world)
    return batches(ToyDataset(), sampler, trainer.ranks, workers)


def silent():
    return logging.Logger("silent", logging.CRITICAL)
