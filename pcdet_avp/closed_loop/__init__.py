"""Perception in the driver's seat: how fast may the car drive? (Paper, "Evaluations of Safety-Critical Scenarios".)"""
