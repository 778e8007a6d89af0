"""Records on disk: the functions that other packages use. No torch here."""

from pcdet_avp.datasets.avp.layout import SCHEMA_VERSION, clean_leftovers, frame_dir, has_frame
from pcdet_avp.datasets.avp.record_reader import read_frame, read_record, recorded_sources
from pcdet_avp.datasets.avp.record_writer import write_frame, write_record
from pcdet_avp.datasets.avp.units import Record

__all__ = [
    "SCHEMA_VERSION",
    "Record",
    "clean_leftovers",
    "frame_dir",
    "has_frame",
    "read_frame",
    "read_record",
    "recorded_sources",
    "write_frame",
    "write_record",
]
