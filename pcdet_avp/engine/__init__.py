"""Training and testing: schedule, sampler, checkpoints, the loop, the benchmark. Works on one CPU or many GPUs."""
