#!/bin/bash
# omega-prime 0.3.7, ttc_and_thw: towards a car that stands in the way there is no time to collision until both touch, and
# afterwards it says how long the crash still takes.
#
# "Metric that computes TTC and THW between `ego_id` and all other objects." It looks only at moments at which the other's
# body covers the place of the ego's, at most 2 s (time_buffer) earlier or later. A car that stands was never where the ego
# is now: no row. One that drives ahead has rows while it is less than 2 s ahead; a car 30 m ahead that is a third slower
# comes without one. So the least TTC of a drive is one of the tame encounters, and a parked car, a stopped queue or a
# person who stands are no encounters at all. What is divided is the distance of the middles, not of the bumpers:
# a car's length too much, with which the TTC of a moment at which metal meets metal is not 0.
# The result is null or absent where nothing was computed; neither is told apart from "no conflict".
#
# Way out: no row means "not computed"; TTC from the footprints (gap between bumpers / closing speed) for all objects.
#
# Seen (2026-11-30), ego at 10 m/s, cars of 4.5 m, from middle to middle at the start; time of the contact (s); of so many
# ticks before it, how many have a TTC; the first row: time, TTC, by hand
#     standing, 30 m ahead: 2.55; 0 of 26; 2.6, 0.40, 0.00
#     6.5 m/s, 30 m ahead: 7.29; 37 of 73; 3.6, 4.97, 3.69
#     8 m/s, 12 m ahead: 3.75; 30 of 38; 0.8, 5.20, 2.95
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# More than a GB with all that it requires.
"$folder/venv/bin/pip" install --quiet omega-prime==0.3.7 betterosi==0.9.0 polars==1.44.2 polars-st==0.11.0 numpy==2.4.6 \
    pandas==3.1.1 shapely==2.2.0
MPLBACKEND=Agg "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import polars as pl
from omega_prime import MovingObjectRole, MovingObjectSubtype, MovingObjectType, Recording
from omega_prime.metrics import MetricManager

EGO, OTHER, SPEED, LENGTH = 1, 2, 10.0, 4.5
KIND = {"type": MovingObjectType.VEHICLE, "role": MovingObjectRole.CIVIL, "subtype": MovingObjectSubtype.CAR}


def track(number, start, speed, seconds=8.0):
    """A car along the x axis, ten times a second."""
    times = np.arange(0, seconds, 0.1)
    columns = dict.fromkeys(("y", "z", "vel_y", "vel_z", "acc_x", "acc_y", "acc_z", "roll", "pitch", "yaw"), 0.0)
    columns |= {"vel_x": speed, "length": LENGTH, "width": 1.8, "height": 1.5}
    columns |= {"idx": number} | {name: int(kind) for name, kind in KIND.items()}
    columns = {name: np.full(len(times), value) for name, value in columns.items()}
    return pl.DataFrame({"total_nanos": np.round(1e9 * times).astype(np.int64), "x": start + speed * times, **columns})


found = []
for name, speed, ahead in (("standing", 0.0, 30.0), ("6.5 m/s", 6.5, 30.0), ("8 m/s", 8.0, 12.0)):
    drive = Recording(df=pl.concat([track(EGO, 0.0, SPEED), track(OTHER, ahead, speed)]))
    _, tables = MetricManager().compute(drive, ego_id=EGO)
    rows = tables["ttc_and_thw"].filter(pl.col("TTC").is_not_null()).sort("total_nanos_ego")
    contact = (ahead - LENGTH) / (SPEED - speed)
    times = rows["total_nanos_ego"].to_numpy() / 1e9
    by_hand = max(0.0, contact - times[0])
    ticks = f"{(times < contact).sum()} of {int(10 * contact) + 1}"
    found.append((ticks, f"{times[0]:.1f}, {rows['TTC'][0]:.2f}, {by_hand:.2f}"))
    print(f"{name}, {ahead:.0f} m ahead: {contact:.2f}; " + "; ".join(found[-1]))
as_seen = found == [
    ("0 of 26", "2.6, 0.40, 0.00"),
    ("37 of 73", "3.6, 4.97, 3.69"),
    ("30 of 38", "0.8, 5.20, 2.95"),
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
