"""One latent as sparse arrays: what a packet carries of it, and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pcdet_avp.errors import GeometryError
from pcdet_avp.models.compression.rounding import int8_exponents


@dataclass(frozen=True, eq=False)
class SparseLatent:
    """The occupied cells of one map.

    occupied (h, w) bool; values (n, c) float16, or int8 with exponents (c,) int8: the value is v * 2**exponent.
    Cells are in row-major order.
    """

    occupied: np.ndarray
    values: np.ndarray
    exponents: np.ndarray | None = None


def to_arrays(latent: Tensor, precision: str) -> SparseLatent:
    """latent (c, h, w) as ``MapCodec.compress`` returns it; nothing is lost."""
    occupied = (latent != 0).any(0)
    cells = latent[:, occupied].T
    if precision == "float16":
        return SparseLatent(occupied.cpu().numpy(), cells.half().cpu().numpy())
    exponents = int8_exponents(latent).view(-1)
    values = torch.ldexp(cells, -exponents).round()
    return SparseLatent(*(t.cpu().numpy() for t in (occupied, values.to(torch.int8), exponents.to(torch.int8))))


def from_arrays(sparse: SparseLatent) -> Tensor:
    """(c, h, w) float32."""
    count, (n, c) = int(np.count_nonzero(sparse.occupied)), sparse.values.shape
    if count != n:
        raise GeometryError(f"latent: the mask has {count} occupied cells, found values of {n}")
    cells = torch.from_numpy(sparse.values).float()
    if sparse.exponents is not None:
        cells = torch.ldexp(cells, torch.from_numpy(sparse.exponents).int())
    latent = torch.zeros(c, *sparse.occupied.shape)
    latent[:, torch.from_numpy(sparse.occupied)] = cells.T
    return latent


def to_sparse_coo(latent: Tensor) -> Tensor:
    """latent (c, h, w) -> hybrid sparse tensor (h, w, c): indices of the occupied cells, their vectors as values."""
    dense = latent.permute(1, 2, 0)
    indices = (latent != 0).any(0).nonzero().T
    values = dense[indices[0], indices[1]]
    return torch.sparse_coo_tensor(indices, values, dense.shape, is_coalesced=True, check_invariants=True)
