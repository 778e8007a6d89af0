"""The path under which ``draw_scenario`` was published; it lives in ``sim.scenarios.table``."""

from pcdet_avp.sim.scenarios.table import SCENARIOS, draw_scenario

__all__ = ["SCENARIOS", "draw_scenario"]
