"""Two processes with a sample each have the gradients of one process with both."""

import faulthandler
import multiprocessing
import os
import socket
import tempfile
import warnings

import pytest
import torch
import torch.distributed as dist
from torch.nn.parallel import DistributedDataParallel

PATIENCE_S = 60  # with a rank that has nothing left to do but to end


def gradients(model, network, batch):
    model.train()(batch)[0]["loss"].backward()
    return {name: None if p.grad is None else p.grad.clone() for name, p in network.named_parameters()}


def one_rank(tiny, rank, port, queue, stacks, combos, changes):
    torch.set_num_threads(1)
    faulthandler.dump_traceback_later(PATIENCE_S / 2, file=stacks[rank])
    os.environ.update(MASTER_ADDR="127.0.0.1", MASTER_PORT=str(port))
    dist.init_process_group("gloo", rank=rank, world_size=2)
    network = tiny.network(**changes)
    parallel = DistributedDataParallel(network, find_unused_parameters=True)
    found = gradients(parallel, network, tiny.select(tiny.batch(combos), rank))
    if rank == 0:
        queue.put({name: None if g is None else g.tolist() for name, g in found.items()})
    dist.barrier()
    dist.destroy_process_group()


def in_two_processes(*arguments):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    tiny, *rest = arguments
    with tempfile.TemporaryFile("w+") as first, tempfile.TemporaryFile("w+") as second:
        common = (port, queue, (first, second))
        ranks = [context.Process(target=one_rank, args=(tiny, rank, *common, *rest)) for rank in range(2)]
        for process in ranks:
            process.start()
        result = queue.get()
        for process, stacks in zip(ranks, (first, second), strict=True):
            process.join(PATIENCE_S)
            if process.is_alive():  # behind its result, at the end of its connection: seen twice in some hundred runs
                process.kill()
                stacks.seek(0)
                warnings.warn(f"a rank did not end by itself; it stood at\n{stacks.read()}", stacklevel=2)
            else:
                assert process.exitcode == 0
    return result


@pytest.mark.parametrize(
    ("combos", "changes"),
    [(["CL+CL", "CL+CL"], {}), (["CL+CL", "C+none"], {}), (["CL+CL", "CL+CL"], {"ROADSIDE_MAP_DROPOUT": 0.5})],
    ids=["same sensors", "different sensors", "lost maps"],
)
def test_gradients_do_not_depend_on_the_number_of_processes(tiny, combos, changes):
    """The samples have unequal numbers of positive anchors, so a rank's own normaliser would show."""
    expected = gradients(*[tiny.network(**changes)] * 2, fewer_boxes(tiny.batch(combos)))
    tiny.batch = with_fewer_boxes(tiny.batch)
    found = in_two_processes(tiny, combos, changes)
    for name, gradient in expected.items():
        if gradient is None:
            assert found[name] is None or not torch.tensor(found[name]).any(), name
        else:
            torch.testing.assert_close(torch.tensor(found[name]), gradient, rtol=1e-5, atol=1e-6, msg=name)


def fewer_boxes(batch):
    """Without the car of the second sample."""
    batch["gt_boxes"][1, 0] = 0
    return batch


def with_fewer_boxes(make_batch):
    return lambda combos: fewer_boxes(make_batch(combos))
