"""A recording in another layout as a data set of ours; an interrupted import goes on.

python tools/import_data.py --format opv2v --src OPV2V --out data/opv2v
python tools/import_data.py --format dair_v2x --src cooperative-vehicle-infrastructure --out data/dair_v2x
python tools/import_data.py --format carla --src my_recording --out data/carla

docs/own_data.md describes the three layouts.
"""

from pcdet_avp.commands.import_data import run

if __name__ == "__main__":
    run()
