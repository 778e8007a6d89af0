#!/bin/bash
# statsmodels 0.15.0, intervals of a rate or share after no event at all: some leave the estimate, 0, outside.
#
# No crash in 100 hours is what a safety case hopes for. The lower limit is 0 then: any rate, as small as you like, leads
# to no event. confint_poisson(0, 100) with method "midp-c" or "sqrt" returns the upper limit twice: an interval without
# width, after which 0.03 (or 0.0096) crashes an hour are certain and none at all is ruled out. The root finder of midp-c
# does not come to the end of its range, 0; sqrt is as wide as the root of the count. "jeff", and "jeffreys" of
# proportion_confint, keep a lower limit of some millionths above 0; Brown, Cai and DasGupta (2001), whom its
# documentation cites, set it to 0 there. "wald" and proportion_confint's default, "normal", say that the rate is 0
# exactly, which at least is well known. Of a count of 0 the documentation of confint_poisson says nothing.
# The upper limits are those of two-sided intervals: "exact-c" gives 3.69 events, "three over n" is one-sided.
#
# Way out: "exact-c" and "beta" (Clopper-Pearson), with alpha doubled for a one-sided limit: 3.00 events.
#
# Seen (2026-11-30), 0 events in 100 hours; 0 crashes in 20 runs; lower, upper:
#     exact-c 0, 0.0369; alpha doubled 0, 0.0300
#     midp-c 0.03, 0.0300
#     sqrt 0.0096, 0.0096
#     jeff 4.91e-06, 0.0251
#     wald 0, 0.0000
#     beta 0, 0.1684; jeffreys 2.42e-05, 0.1166; normal 0, 0.0000
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet statsmodels==0.15.0 numpy==2.4.6 scipy==1.17.1 pandas==3.1.1
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

from statsmodels.stats.proportion import proportion_confint
from statsmodels.stats.rates import confint_poisson


def of_rate(method, alpha=0.05):
    return tuple(float(limit) for limit in confint_poisson(0, 100.0, method=method, alpha=alpha))


def of_share(method):
    return tuple(float(limit) for limit in proportion_confint(0, 20, method=method))


def text(limits):
    return f"{limits[0]:.3g}, {limits[1]:.4f}"


rates = {method: of_rate(method) for method in ("exact-c", "midp-c", "sqrt", "jeff", "wald")}
shares = {method: of_share(method) for method in ("beta", "jeffreys", "normal")}
one_sided = of_rate("exact-c", 0.1)
print(f"exact-c {text(rates['exact-c'])}; alpha doubled {text(one_sided)}")
for method in ("midp-c", "sqrt", "jeff", "wald"):
    print(method, text(rates[method]))
print("; ".join(f"{method} {text(limits)}" for method, limits in shares.items()))
as_seen = rates["exact-c"][0] == 0 and f"{one_sided[1]:.4f}" == "0.0300" and shares["beta"][0] == 0
as_seen &= all(abs(rates[method][0] - rates[method][1]) < 1e-8 < rates[method][0] for method in ("midp-c", "sqrt"))
as_seen &= rates["jeff"][0] > 0 and shares["jeffreys"][0] > 0 and rates["wald"] == shares["normal"] == (0, 0)
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
