"""Train a network; makes the data set first if there is none, and prints the benchmark table at the end.

    python tools/train.py --cfg cfgs/avp/cp_small_scratch.yaml                      from scratch: two CPU cores, hours
    python tools/train.py --cfg cfgs/avp/cp_small_scratch.yaml --max_minutes 90     the whole schedule in 90 minutes
    python tools/train.py --cfg cfgs/avp/cp_small.yaml --pretrained_model weights/cp_small.pth      weights further
    torchrun --nproc_per_node 8 tools/train.py --cfg cfgs/avp/cp_full.yaml --launcher pytorch --use_amp

Everything goes to output/<group>/<tag>/<extra_tag>/ below the working directory: checkpoints, TensorBoard, log,
benchmark. Stop it when you like, by Ctrl-C or otherwise; the same command goes on.
"""

from pcdet_avp.commands.train import run

if __name__ == "__main__":
    run()
