"""When examples/roadside_unit.py ends."""

import time
from types import SimpleNamespace

from pcdet_avp.engine.real_time import RealTimeReport


def test_a_slow_rate_does_not_hold_the_end_up(example):
    """At a map in a hundred seconds it slept to the next one, however long it was to send."""
    unit = example("roadside_unit")
    half = SimpleNamespace(segments=lambda *_: {"infra_lidar": [b"map"]})
    sender = SimpleNamespace(send=lambda payloads: None, check_heard=lambda: None)
    frame = SimpleNamespace(infra=SimpleNamespace(world_from_agent=None))
    args = SimpleNamespace(seconds=0.2, rate=0.01, unit=0)
    began_s, report = time.monotonic(), RealTimeReport("roadside", "torch", args.rate)
    if 100 - time.time() % 100 < 10:
        args.rate = 0.007  # the next tick is far, whenever the test runs
    unit.send(half, [({}, frame)], sender, report, args)
    assert report.done == 1
    assert time.monotonic() - began_s < 5
