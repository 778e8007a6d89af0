"""A checkpoint of OpenPCDet's PointPillar as one of ours, and what of it was used.

python tools/import_openpcdet.py --cfg cfgs/avp/ablations/from_openpcdet.yaml --ckpt openpcdet.pth --out start.pth
python tools/train.py --cfg cfgs/avp/ablations/from_openpcdet.yaml --pretrained_model start.pth

The second command takes OpenPCDet's file as well; this one shows beforehand what it would do.
"""

from pcdet_avp.commands.import_openpcdet import run

if __name__ == "__main__":
    run()
