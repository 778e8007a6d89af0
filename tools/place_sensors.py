"""Where the sensors of a garage should hang, and how fast a car may then drive.

    python tools/place_sensors.py --plan cfgs/plans/two_lane_loop.yaml --out output/placement/loop
    python tools/place_sensors.py --plan my_garage.yaml --units 6 --candidates 300 --members 0

Writes placement.json and index.html; the same command goes on where it stopped.
"""

from pcdet_avp.commands.place_sensors import run

if __name__ == "__main__":
    run()
