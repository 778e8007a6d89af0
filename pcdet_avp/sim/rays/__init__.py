"""Rays through the scene on Embree: the ray tracer, LiDAR sweeps, lines of sight and their caches."""
