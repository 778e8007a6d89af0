"""What a foreign framework gets from us: our classes with the few adjustments that its scripts need.

Nothing here imports OpenPCDet. ``pcdet_avp.plugin`` puts these classes into OpenPCDet's tables.
"""
