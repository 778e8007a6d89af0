"""Check a garage's plan and draw it.

    python tools/garage.py --plan cfgs/plans/two_lane_loop.yaml --out output/loop
    python tools/garage.py --plan my_garage.yaml --check

Every mistake is one line with the plan's line number.
"""

from pcdet_avp.commands.garage import run

if __name__ == "__main__":
    run()
