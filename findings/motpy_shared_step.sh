#!/bin/bash
# motpy 0.0.10 (tracks of boxes), MultiObjectTracker: a tracker's time step is that of the tracker that was made last.
#
# dt is written into the dictionary that model_spec is: a preset's, of which there is one for the process, or the caller's own.
# Objects that come into view get their Kalman filters from there, when they come. So a program that follows the roadside's
# detections at 10 Hz and afterwards makes a second tracker for a camera at 1 Hz has the first one's filters predict a
# second ahead at each step: a car at 10 m/s is followed at its place, but its speed is 1 m/s, and where it will be while
# it is hidden is wrong by as much. What was tracked before keeps its step. With one tracker, or with equal steps, nothing
# shows.
#
# Way out: a dictionary of your own for each tracker, dict(ModelPreset.constant_velocity_and_static_box_size_2d.value).
#
# Seen (2026-12-01), a car at 10 m/s, dt=0.1, 20 steps: its speed in the filter; that after another tracker was made with
# dt=1.0; that with a dictionary for each
#     10.0; 1.0; 10.0
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-deps motpy==0.0.10 filterpy==1.4.5 numpy==2.4.6 scipy==1.17.1
"$folder/venv/bin/python" - <<'PYTHON'
import sys

from motpy import Detection, ModelPreset, MultiObjectTracker

PRESET = ModelPreset.constant_velocity_and_static_box_size_2d


def speed(spec, *others):
    """Of a car that is tracked at 10 Hz from the time on when all trackers are there."""
    tracker = MultiObjectTracker(dt=0.1, model_spec=spec)
    for other in others:
        MultiObjectTracker(dt=1.0, model_spec=other)
    for step in range(20):
        tracker.step([Detection(box=[step - 2.25, -0.9, step + 2.25, 0.9])])
    (track,) = tracker.trackers
    return f"{track._tracker.x[1]:.1f}"


found = "; ".join((speed(PRESET.name), speed(PRESET.name, PRESET.name), speed(dict(PRESET.value), dict(PRESET.value))))
print(found)
as_seen = found == "10.0; 1.0; 10.0"
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
