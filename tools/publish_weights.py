"""What others need of a finished run: weights, thresholds and what they are about, without the optimiser's state.

python tools/publish_weights.py --ckpt output/avp/cp_small/default/ckpt/checkpoint_epoch_30.pth --out cp_small.pth
python tools/publish_weights.py --ckpt weights/cp_small.pth --out cp_small.safetensors        for other programs, too
"""

from pcdet_avp.commands.publish_weights import run

if __name__ == "__main__":
    run()
