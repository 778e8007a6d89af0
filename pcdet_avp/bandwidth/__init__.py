"""What the roadside's maps cost on the air and what they are worth there: the studies of ``tools/bandwidth_report.py``.

``plan`` says what is varied, ``frame_runner`` takes one frame through all of it, ``study`` all frames; ``rows`` turns
the results into numbers, ``report`` and ``plots`` into something to read.
"""
