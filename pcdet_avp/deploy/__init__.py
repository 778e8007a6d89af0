"""An exported network without torch: both halves on onnxruntime or OpenVINO, with numpy and numba around them.

What stands outside the graphs is geometry and bookkeeping: points to pillars (``pillars``), voxels into the image
(``frustum``), the roadside's grid in the vehicle's (``warp``), anchors, scores and suppression (``post_processing``).
Frames and units are those of ``pcdet_avp.structures``. ``tools/export.py`` writes what is read here.
"""
