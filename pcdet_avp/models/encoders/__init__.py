"""Encoders, each from one sensor of one agent to a bird's-eye-view map."""
