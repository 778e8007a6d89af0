"""Networks as ONNX: forms of the modules in plain operations, what the graphs leave open, and the files.

Importing this package imports nothing else. ``pcdet_avp.deploy`` runs what is written here, without torch.
"""
