"""Foreign recordings as our records: one file for each layout, and what they share.

``axes.py`` turns the others' axes, angles, sizes and calibration into ours; ``recording.py`` says what a layout's
reader gives; ``run.py`` writes the data set. docs/own_data.md describes the layouts for users.
"""
