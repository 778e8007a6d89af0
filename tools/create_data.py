"""Make a data set of the embedded garage, or finish one that was interrupted.

    python tools/create_data.py --cfg cfgs/avp/cp_small.yaml --preview 6
    python tools/create_data.py --cfg cfgs/avp/cp_full.yaml --workers 8
    python tools/create_data.py --cfg cfgs/avp/cp_full.yaml --scheduler tcp://host:8786

Prints what the data set holds and what its sensors can see; ``--preview K`` writes pictures of K test frames.
"""

from pcdet_avp.commands.create_data import run

if __name__ == "__main__":
    run()
