"""Stand-ins for what OpenPCDet needs and a machine without a GPU lacks. For tests; nothing of ours needs them.

    python tests/openpcdet/openpcdet_shims.py -m pcdet_avp.plugin OPENPCDET/tools/train.py --cfg_file ...

installs them and then runs a module as ``python -m`` would. A package that is really there is left alone.
"""

import importlib.abc
import importlib.machinery
import importlib.util
import runpy
import sys
import time
import types

import numba.cuda
import torch
from torch import nn

from pcdet_avp.structures.rotated_iou import bev_iou

# Imported by OpenPCDet whatever one does with it, used by none of the detectors that are tested here.
PACKAGES = ("spconv", "torchvision", "skimage", "SharedArray", "pyquaternion", "av2", "pandas", "tensorboardX")
# Compiled for CUDA by its setup.py, or written by it.
COMPILED = (
    "pcdet.ops.iou3d_nms.iou3d_nms_cuda",
    "pcdet.ops.roiaware_pool3d.roiaware_pool3d_cuda",
    "pcdet.ops.roipoint_pool3d.roipoint_pool3d_cuda",
    "pcdet.ops.pointnet2.pointnet2_batch.pointnet2_batch_cuda",
    "pcdet.ops.pointnet2.pointnet2_stack.pointnet2_stack_cuda",
    "pcdet.ops.ingroup_inds.ingroup_inds_cuda",
    "pcdet.ops.bev_pool.bev_pool_ext",
    "pcdet.version",
    "pcdet.datasets.argo2.argo2_dataset",
)


class Stub(types.ModuleType):
    """A module, and package, in which every name is an empty ``nn.Module`` class."""

    __version__ = "2.3.8"
    __path__ = ()

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (nn.Module,), {})


class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds the packages that are missing and the compiled modules."""

    def __init__(self):
        self.missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]

    def find_spec(self, fullname, path=None, target=None):
        if fullname in COMPILED or fullname.partition(".")[0] in self.missing:
            return importlib.machinery.ModuleSpec(fullname, self, is_package=True)
        return None

    def create_module(self, spec):
        return Stub(spec.name)

    def exec_module(self, module):
        if module.__name__.endswith("iou3d_nms_cuda"):
            module.nms_gpu, module.boxes_overlap_bev_gpu = nms, overlap_bev
        if module.__name__ == "spconv.pytorch":
            module.conv = Stub("spconv.pytorch.conv")
        if module.__name__ == "tensorboardX":
            from torch.utils.tensorboard import SummaryWriter

            module.SummaryWriter = SummaryWriter


def nms(boxes, keep, threshold):
    """Greedy, by falling score, as OpenPCDet's operator: indices into ``keep``, their number returned."""
    overlaps = bev_iou(boxes.detach().double().numpy(), boxes.detach().double().numpy())
    kept = []
    for i in range(len(boxes)):
        if all(overlaps[i, j] <= threshold for j in kept):
            kept.append(i)
    keep[: len(kept)] = torch.tensor(kept, dtype=keep.dtype)
    return len(kept)


def overlap_bev(a, b, out):
    """Area of intersection from the IoU: u = (A + B) iou / (1 + iou)."""
    iou = torch.from_numpy(bev_iou(a.detach().double().numpy(), b.detach().double().numpy())).to(out)
    areas = (a[:, 3] * a[:, 4])[:, None] + b[:, 3] * b[:, 4]
    out.copy_(areas * iou / (1 + iou))


def on_a_cpu():
    """``.cuda()`` stays where it is, kernels are not compiled, nobody waits half a minute for another checkpoint."""
    torch.Tensor.cuda = nn.Module.cuda = lambda self, *_, **__: self
    torch.cuda.FloatTensor = torch.zeros
    numba.cuda.jit = lambda *_, **__: lambda function: function
    sleep = time.sleep
    time.sleep = lambda seconds: sleep(min(seconds, 0.01))


def install():
    """Everything above. Must come before OpenPCDet is imported."""
    on_a_cpu()
    sys.meta_path.insert(0, Finder())
    load = torch.load  # OpenPCDet's checkpoints hold numpy numbers, which torch >= 2.6 refuses by default
    torch.load = lambda *args, **kwargs: load(*args, **{"weights_only": False, **kwargs})


if __name__ == "__main__":
    install()
    module = sys.argv[2]
    sys.argv = sys.argv[2:]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
