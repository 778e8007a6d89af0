"""A configuration as one file that OpenPCDet's own tools/train.py and tools/test.py accept.

python tools/export_openpcdet.py                                                  cfgs/openpcdet/ from cfgs/avp/
python tools/export_openpcdet.py --cfg cfgs/avp/ablations/max_fusion.yaml --out max_fusion.yaml
"""

from pcdet_avp.commands.export_openpcdet import run

if __name__ == "__main__":
    run()
