#!/bin/bash
# l5kit 1.5.0 (Lyft's Level 5 prediction data set), ADE and FDE: steps that nobody saw count as predicted without an error.
#
# A road user that leaves the sensors' range or is hidden has no position from then on; avails says which steps exist,
# "availability for each gt timesteps". "average displacement over all timesteps": an absent step's error is set to 0 and
# counts in the mean, so that the error of one who was seen for 1 of 5 s is a fifth of what it is. FDE, "displacement calculated
# at the last timestep", is 0 for all who are not there any more at the end. rmse divides by all steps, too. A set with many
# occlusions makes a model look better than one without. Of several predictions the best is still picked; with all steps
# there, all is right, and so is neg_multi_log_likelihood, the data set's own score, which is a sum.
#
# Way out: pass the steps that exist alone, ground_truth[avails > 0] and pred[:, avails > 0], and note for FDE how far that is.
#
# Seen (2026-12-01), 50 steps of 0.1 s, a prediction that is 2 m off at each of them: ADE, FDE, rmse
#     seen for 50: 2.00 2.00 2.00
#     seen for 10: 0.40 0.00 0.89
#     the 10 alone: 2.00 2.00 2.00
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# The metrics need these two; torch is imported for types and functions that are not looked at here.
"$folder/venv/bin/pip" install --quiet --no-deps l5kit==1.5.0 numpy==2.4.6 shapely==2.2.0
"$folder/venv/bin/python" - <<'PYTHON'
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

import numpy as np

for name in ("l5kit", "l5kit.evaluation", "l5kit.planning"):
    package = sys.modules[name] = ModuleType(name)
    package.__path__ = [str(Path(sysconfig.get_path("purelib"), *name.split(".")))]
torch = sys.modules["torch"] = ModuleType("torch")
torch.Tensor = object

from l5kit.evaluation.metrics import average_displacement_error_mean, final_displacement_error_mean, rmse

STEPS, SEEN = 50, 10
truth = np.stack([np.arange(STEPS) * 0.5, np.zeros(STEPS)], axis=1)
prediction = (truth + (0, 2))[None]


def errors(truth, prediction, available):
    metrics = (average_displacement_error_mean, final_displacement_error_mean, rmse)
    return " ".join(f"{metric(truth, prediction, np.ones(1), available):.2f}" for metric in metrics)


left = (np.arange(STEPS) < SEEN).astype(float)
found = {
    "seen for 50": errors(truth, prediction, np.ones(STEPS)),
    "seen for 10": errors(truth, prediction, left),
    "the 10 alone": errors(truth[left > 0], prediction[:, left > 0], np.ones(SEEN)),
}
print("\n".join(f"{name}: {values}" for name, values in found.items()))
as_seen = list(found.values()) == ["2.00 2.00 2.00", "0.40 0.00 0.89", "2.00 2.00 2.00"]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
