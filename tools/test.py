"""The benchmark table of a trained network, beside the paper's; of a depth branch alone, the table of its errors.

python tools/test.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth
python tools/test.py --cfg cfgs/avp/cp_small.yaml --ckpt F --combos C+none,C+CL --json result.json
python tools/test.py --cfg cfgs/avp/cp_small.yaml --eval_all          every checkpoint of a run, on the val split
python tools/test.py --cfg cfgs/avp/cp_small_depth.yaml --ckpt F      the cameras' depth errors, on the val split
"""

from pcdet_avp.commands.test import run

if __name__ == "__main__":
    run()
