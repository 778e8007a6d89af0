"""The closed loop's scenarios that play on a plan's floor, by the names of those in drawn garages.

Trials take the floor's sites in turn, so that all of them are driven.
"""

from __future__ import annotations

from pcdet_avp.sim.scenarios.plan_crossing import pedestrian_on_plan
from pcdet_avp.sim.scenarios.plan_junction import junction_on_plan

PLAN_SCENARIOS = {"pedestrian": pedestrian_on_plan, "t_junction": junction_on_plan}
