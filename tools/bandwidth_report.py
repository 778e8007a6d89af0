"""What roadside maps cost on the air and what they are worth there: bytes, rate, AP against bytes, loss and pose error.

python tools/bandwidth_report.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth
python tools/bandwidth_report.py --cfg cfgs/avp/cp_small.yaml --ckpt F --every 2 --combos CL+CL      a fifth of the time
python tools/bandwidth_report.py --cfg cfgs/avp/cp_small.yaml --ckpt F --studies budget,loss

Writes report.md, bandwidth.json and plots; the same command goes on where it stopped.
"""

from pcdet_avp.commands.bandwidth_report import run

if __name__ == "__main__":
    run()
