"""A trained network as ONNX, the roadside's half and the vehicle's, for machines without torch.

python tools/export.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth --out exported
"""

from pcdet_avp.commands.export import run

if __name__ == "__main__":
    run()
