"""The embedded parking garage: layouts, actors, ray-traced cameras and LiDARs, scenarios, a stepping world.

numpy, numba and Embree only; nothing here imports torch.
"""
