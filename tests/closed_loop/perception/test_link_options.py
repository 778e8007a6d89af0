"""What a user may ask of the link, and what is refused in one line."""

import argparse

import pytest

from pcdet_avp.closed_loop.perception.link_options import LinkOptions, add_link_arguments, given_link_options
from pcdet_avp.errors import AvpError, ConfigError


def parsed(*words):
    parser = argparse.ArgumentParser()
    add_link_arguments(parser)
    args = parser.parse_args(words)
    return LinkOptions.of(args.link, given_link_options(args))


def test_the_flags_are_the_options():
    options = parsed("--link", "nr_v2x", "--mcs", "14", "--block_loss", "0.05", "--burst_slots", "4", "--hold_ms", "0")
    assert options == LinkOptions("nr_v2x", mcs=14, block_loss=0.05, burst_slots=4.0, hold_ms=0.0)
    channel = options.nr_v2x()
    assert channel.rate_bps == pytest.approx(24.1e6, rel=1e-3)
    assert channel.loss.mean_loss == pytest.approx(0.05)
    assert 1 / channel.loss.bad_to_good == pytest.approx(4.0)


def test_without_flags_the_link_is_ideal():
    assert parsed() == LinkOptions()


@pytest.mark.parametrize(
    ("link", "given", "message"),
    [
        ("ideal", {"block_loss": 0.1}, "--block_loss: an ideal link has no such thing"),
        ("wlan", {}, "--link: expected ideal or nr_v2x, found 'wlan'"),
        ("nr_v2x", {"bandwidth": 1}, "unknown option 'bandwidth'"),
        ("nr_v2x", {"hold_ms": -1.0}, "--hold_ms: expected 0 or more, found -1.0"),
        ("nr_v2x", {"sensing_ms": float("nan")}, "--sensing_ms"),
    ],
)
def test_what_cannot_be_is_refused(link, given, message):
    with pytest.raises(ConfigError, match=message):
        LinkOptions.of(link, given)


@pytest.mark.parametrize(
    "given", [{"mcs": 9}, {"block_loss": 1.5}, {"repetitions": 0}, {"deadline_ms": 0.0}, {"burst_slots": 0.0}]
)
def test_so_is_what_the_channel_refuses(given):
    with pytest.raises(AvpError):
        LinkOptions.of("nr_v2x", given)
