"""The words every part of the package speaks: grids, boxes, poses, cameras, frames, sensor sets.

numpy only; nothing here imports torch. SI units, radians, right-handed frames with x forward,
y left, z up, and the floor at z = 0.
"""
