"""Pictures or a video of what a network finds, without and with the roadside. Needs no display.

python tools/demo.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth                       a video
python tools/demo.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth --frame 0012/003      one picture
python tools/demo.py --cfg cfgs/avp/cp_small.yaml --ckpt F --data_path CLOUD.bin     a cloud of yours, or a folder
"""

from pcdet_avp.commands.demo import run

if __name__ == "__main__":
    run()
