"""The exceptions a user can meet. Each message names what was expected, what came, and where.

Tools print an ``AvpError`` as one line and exit with status 2; anything else is a bug of ours.
"""


class AvpError(Exception):
    """Base of every error that is caused by input rather than by a bug."""


class ConfigError(AvpError):
    """A configuration file or a ``--set`` override is missing, malformed or names an unknown key."""


class OutputError(AvpError):
    """A file, picture, video or folder of results cannot be written."""


class RegistryError(AvpError):
    """A name is unknown to a registry, or registered twice."""


class GeometryError(AvpError):
    """A pose, box, camera or grid has a wrong shape or impossible values."""


class RecordError(AvpError):
    """A file of a data set is missing, truncated, damaged, foreign or of another schema version."""


class SensorError(AvpError):
    """A sensor combination is unknown, a sample holds no usable sensor at all, or what came in is not a number."""


class EvaluationError(AvpError):
    """Detections and ground truth do not belong together, or a score is not a number."""


class CheckpointError(AvpError):
    """A checkpoint is missing, truncated, damaged, made by another configuration, or cannot be written."""


class TrainingError(AvpError):
    """Training cannot go on: the loss or its gradient is not a number."""


class PacketError(AvpError):
    """A payload is damaged, truncated or foreign, or a map cannot be put into one."""


class LinkError(AvpError):
    """A link's parameters are impossible, a payload is too large for its blocks, or its clock ran backwards."""


class PluginError(AvpError):
    """OpenPCDet or MMEngine is absent or not as expected there, or a name that one of our classes needs is taken."""


class ExportError(AvpError):
    """A network cannot be exported, or an exported one is missing, damaged, or nothing here can run it."""
