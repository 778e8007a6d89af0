"""Stages that work on bird's-eye-view maps (B, C, H, W)."""
