"""Command line of a certification: ``tools/safety_eval.py --certify``."""

from __future__ import annotations

import argparse
from dataclasses import replace

from pcdet_avp.argument_types import non_negative_int, positive_float, positive_int, share
from pcdet_avp.closed_loop.certify.climb import Certification
from pcdet_avp.closed_loop.certify.rate_tests import METHODS, FixedNumber, RateTest, Sequential
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.errors import ConfigError

CERTIFICATE_SEEDS = 1_000_000  # seeds from here on belong to certificates alone; ``--seed`` counts from it
ONLY_HERE = ("rate", "alpha", "method", "allowed_crashes", "budget", "max_minutes")


def add_certificate_arguments(parser: argparse.ArgumentParser) -> None:
    """``--certify`` and its options; absent ones are None, so that they can be refused where they mean nothing."""
    group = parser.add_argument_group("certificate (instead of a crash table)")
    group.add_argument("--certify", action="store_true", help="the speed up to which the crash rate is bounded")
    group.add_argument("--rate", type=share, help="the crash rate to be ruled out (default: 0.05)")
    group.add_argument("--alpha", type=share, help="probability of a false certificate, at most (default: 0.05)")
    group.add_argument("--method", choices=METHODS, help="fixed number of runs, or a sequential test (default: fixed)")
    group.add_argument("--allowed_crashes", type=non_negative_int, help="fixed: how many runs may crash (default: 0)")
    group.add_argument("--budget", type=positive_int, help="sequential: the most runs of a speed (default: 3x clean)")
    group.add_argument("--max_minutes", type=positive_float, help="begin nothing new after so long; goes on later")


def check_certificate_arguments(args: argparse.Namespace) -> None:
    """ConfigError for options that mean nothing together, and for a table with a certificate's seed."""
    if args.certify:
        for name, given in (("--search", args.search), ("--trials", args.trials is not None), ("--video", args.video)):
            if given:
                raise ConfigError(f"{name}: belongs to crash tables, not to --certify")
        return
    for name in ONLY_HERE:
        if getattr(args, name) is not None:
            raise ConfigError(f"--{name}: belongs to --certify")
    if args.seed >= CERTIFICATE_SEEDS:
        raise ConfigError(
            f"--seed: expected less than {CERTIFICATE_SEEDS} (certificates have those), found {args.seed}"
        )


def rate_test(args: argparse.Namespace) -> RateTest:
    """The test that the options describe; ConfigError where they conflict."""
    rate, alpha = (0.05 if value is None else value for value in (args.rate, args.alpha))
    if (args.method or "fixed") == "fixed":
        if args.budget is not None:
            raise ConfigError("--budget: belongs to --method sequential; a fixed number follows from --allowed_crashes")
        return FixedNumber(rate, alpha, args.allowed_crashes or 0)
    if args.allowed_crashes is not None:
        raise ConfigError("--allowed_crashes: belongs to --method fixed; a sequential test lets --budget decide")
    return Sequential(rate, alpha, args.budget)


def certification(sweep: Sweep, args: argparse.Namespace) -> Certification:
    """What is to be certified, on seeds of its own."""
    test = rate_test(args)
    return Certification(replace(sweep, trials=test.budget, seed=CERTIFICATE_SEEDS + args.seed), test)
