"""One episode of the closed loop for other people's tools: a page to scrub, MCAP, Rerun, OpenSCENARIO, CommonRoad.

    python tools/export_episode.py --scenario t_junction --perception oracle --speed 6 --trial 0 --formats html mcap
    python tools/export_episode.py --scenario pedestrian_late --perception los --combo C+CL --speed 8 --formats xosc

The drive is the one of tools/safety_eval.py with the same arguments. Formats: docs/episodes.md.
"""

from pcdet_avp.commands.export_episode import run

if __name__ == "__main__":
    run()
