"""Small garage plans for tests."""

from pathlib import Path

from pcdet_avp.sim.plans.read import parse_plan, read_plan

PLANS = Path(__file__).parents[1] / "cfgs" / "plans"
SHIPPED = tuple(sorted(PLANS.glob("*.yaml")))

# A road of 40 m along x with lanes of 3 m; line numbers are counted by the tests.
STRAIGHT = """\
plan: 1
name: Straight
floors:
  - name: A
    ceiling_m: 3.0
    roads:
      - {id: main, start: [0, 0], geometry: [{line_m: 40}], lanes: {right: [3.0], left: [3.0]}}
"""


def written(folder, text=STRAIGHT, more=""):
    """A file with a plan's text, and more lines of its last floor."""
    file = Path(folder) / "plan.yaml"
    file.write_text(text + more)
    return file


def parsed(folder, text=STRAIGHT, more=""):
    """Its first floor, unchecked."""
    return parse_plan(written(folder, text, more)).floors[0]


def floor_of(name):
    """The first floor of a shipped plan."""
    return read_plan(PLANS / f"{name}.yaml").floors[0]
