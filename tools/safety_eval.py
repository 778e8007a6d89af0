"""How fast may the car drive? Crash tables by cruising speed and sensor combination.

    python tools/safety_eval.py --scenario pedestrian --perception oracle          no data, no weights; seconds
    python tools/safety_eval.py --scenario t_junction --perception los --search    the edge only
    python tools/safety_eval.py --cfg C --ckpt F --scenario pedestrian_late --perception model
    python tools/safety_eval.py --cfg C --ckpt F --scenario t_junction --perception model --link nr_v2x --mcs 14
    python tools/safety_eval.py --certify --rate 0.05 --scenario t_junction --perception los   the certified speed

Writes episodes.csv, summary.json, wall_times.csv and report.md with its figures, with --video videos of telling
episodes; the same command goes on where it stopped. With --certify: certificate.json, the highest speed up to which
the crash rate is bounded.
"""

from pcdet_avp.commands.safety_eval import run

if __name__ == "__main__":
    run()
