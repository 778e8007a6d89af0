#!/bin/bash
# python-fcl 0.7.0.11 (the Flexible Collision Library), continuousCollide: an object that turns on its way is moved as
# if it did not, so that it passes through what it ends up in.
#
# One hands over the pose at the beginning and the pose at the end and gets "the time of contact in (0,1), or 1.0 if
# the objects did not collide during movement from their initial poses to their final poses". The default request has
# the motion type CCDM_TRANS: the place goes from one to the other and the rotation stays that of the beginning. The
# rotation of the final pose is read and not used, and nothing says so; the C++ library has the same default. A car
# that turns into a slot is checked as one that slides there sideways: contacts of its corners are missed, others are
# made up. Even where collide() finds both in contact at the final pose, continuousCollide() says that there was none.
# Straight moves are right to the last digit, so that a first test finds nothing.
#
# The other motion types are no easy way out. CCDM_LINEAR leaves its point of reference unset, and one and the same
# program answered differently from run to run (seen, not part of the test below). CCDM_SCREW, on a floor the arc of a
# circle from pose to pose, as a car with a fixed wheel drives it, is right where the car turns; a straight way is
# driven as one of its squared length, 100 m instead of 10, and hits what stands far beyond its end.
#
# Way out: CCDM_SCREW for moves with a turn, the default for moves without; or collide() at poses of your own.
#
# Seen (2026-11-30), car of 4.5 x 1.8 m from 0, 0 ahead, pillar of 0.2 m: contact by default, by CCDM_SCREW (share of
# the way), collide() at the end
#     10 m straight, pillar 8 m ahead: 0.565, 0.057, 1
#     10 m straight, pillar 50 m ahead: none, 0.477, 0
#     3 m and 70 degrees to the left, pillar at 3.0, 1.8: none, 0.623, 1
#     3 m and 70 degrees to the left, pillar at 4.9, -0.4: 0.850, none, 0
#     331 moves, 75 with a contact in 200 poses on the arc; missed, made up: 29, 9 by default, 0, 0 by screw
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet python-fcl==0.7.0.11 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import fcl
import numpy as np

CAR, PILLAR, DRAWS, POSES = fcl.Box(4.5, 1.8, 1.5), fcl.Cylinder(0.1, 3.0), 400, 200
KINDS = {"default": {}, "screw": {"ccd_motion_type": fcl.CCDMotionType.CCDM_SCREW}}


def pose(x, y, turn=0.0):
    cos, sin = np.cos(turn), np.sin(turn)
    return fcl.Transform(np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]), np.array([x, y, 0.0]))


def touching(end, pillar):
    return fcl.collide(fcl.CollisionObject(CAR, pose(*end)), fcl.CollisionObject(PILLAR, pose(*pillar)))


def contact(end, pillar, kind):
    """Share of the way from 0, 0 to ``end``, or None."""
    request, result = fcl.ContinuousCollisionRequest(**KINDS[kind]), fcl.ContinuousCollisionResult()
    car, post = fcl.CollisionObject(CAR, pose(0.0, 0.0)), fcl.CollisionObject(PILLAR, pose(*pillar))
    fcl.continuousCollide(car, pose(*end), post, pose(*pillar), request, result)
    return result.time_of_contact if result.is_collide else None


def on_the_arc(x, y, turn, share):
    """The pose after a share of the circular arc from 0, 0 and heading 0 to x, y and ``turn``."""
    middle = np.array([x - y / np.tan(turn / 2), y + x / np.tan(turn / 2)]) / 2
    cos, sin = np.cos(share * turn), np.sin(share * turn)
    return (*(middle - np.array([[cos, -sin], [sin, cos]]) @ middle), share * turn)


def told(share):
    return "none" if share is None else f"{share:.3f}"


turned = np.radians(70)
found = []
for name, end, pillar in (
    ("10 m straight, pillar 8 m ahead", (10.0, 0.0), (8.0, 0.0)),
    ("10 m straight, pillar 50 m ahead", (10.0, 0.0), (50.0, 0.0)),
    ("3 m and 70 degrees to the left, pillar at 3.0, 1.8", (3.0, 0.0, turned), (3.0, 1.8)),
    ("3 m and 70 degrees to the left, pillar at 4.9, -0.4", (3.0, 0.0, turned), (4.9, -0.4)),
):
    shares = [told(contact(end, pillar, kind)) for kind in KINDS]
    found.append((*shares, touching(end, pillar)))
    print(f"{name}: {shares[0]}, {shares[1]}, {found[-1][2]}")
rng = np.random.default_rng(0)
moves = hits = 0
missed, made_up = dict.fromkeys(KINDS, 0), dict.fromkeys(KINDS, 0)
for x, y, turn, *pillar in rng.uniform((-3, -3, -1.5, -4, -4), (3, 3, 1.5, 4, 4), (DRAWS, 5)):
    if touching((0.0, 0.0), pillar):
        continue
    hit = any(touching(on_the_arc(x, y, turn, share), pillar) for share in np.linspace(0, 1, POSES))
    moves, hits = moves + 1, hits + hit
    for kind in KINDS:
        says = contact((x, y, turn), pillar, kind) is not None
        missed[kind] += hit and not says
        made_up[kind] += says and not hit
counts = ", ".join(f"{missed[kind]}, {made_up[kind]} by {kind}" for kind in KINDS)
print(f"{moves} moves, {hits} with a contact in {POSES} poses on the arc; missed, made up: {counts}")
as_seen = found[0][0] == "0.565" and found[1][0] == "none" and found[1][1] != "none"
as_seen &= found[2][0] == "none" and found[2][1:] == ("0.623", 1) and found[3] == ("0.850", "none", 0)
as_seen &= min(missed["default"], made_up["default"]) > 5 and max(missed["screw"], made_up["screw"]) <= 1
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
