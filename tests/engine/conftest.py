"""``toy``: the module beside this file; ``in_two_processes``: what torchrun does, in forks."""

import importlib.util
import multiprocessing
import os
import socket
import sys
from pathlib import Path

import pytest
import torch

from pcdet_avp.engine import distributed


@pytest.fixture(scope="session")
def toy():
    spec = importlib.util.spec_from_file_location("toy", Path(__file__).with_name("toy.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def in_two_processes():
    """``in_two_processes(work, *arguments)``: what ``work(ranks, *arguments)`` returned on either rank."""
    return _in_two_processes


def _free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _in_two_processes(work, *arguments, launcher="pytorch"):
    """Run ``work(ranks, *arguments)`` as torchrun would, in forks; what each rank returned.

    A rank that ends without an answer fails the test: waiting for it would never end.
    """
    context, port = multiprocessing.get_context("fork"), _free_port()
    pipes = [context.Pipe(duplex=False) for _ in range(2)]
    processes = [
        context.Process(target=_rank, args=(work, rank, port, answer, arguments, launcher))
        for rank, (_, answer) in enumerate(pipes)
    ]
    for process in processes:
        process.start()
    for _, answer in pipes:
        answer.close()  # the ranks' ends alone are left, so that a dead rank's pipe is at its end
    results = [given.recv() for given, _ in pipes]
    for process in processes:
        process.join(60)
        assert process.exitcode == 0
    return results


def _rank(work, rank, port, answer, arguments, launcher):
    torch.set_num_threads(1)
    place = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": 2, "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    os.environ.update({key: str(value) for key, value in place.items()})
    ranks = distributed.start(launcher, "cpu")
    answer.send(work(ranks, *arguments))
    distributed.stop()
    sys.exit(0)
