"""The pipeline's own MCAP: a channel per key, protobuf schemas in the file, zstd chunks, indexed."""

from eigenscan.runtime.recording.contents import (
    STEP_NS,
    Contents,
    clock_set_back,
    closed_span,
    contents,
    first_time,
    is_complete,
    message_count,
    read_metadata,
)
from eigenscan.runtime.recording.files import DAMAGE, REPAIRED, RecordingError, WholeReads, parts
from eigenscan.runtime.recording.reading import Record, read
from eigenscan.runtime.recording.writing import PROFILE, RecordingWriter, descriptors, stamp_of

__all__ = [
    "DAMAGE",
    "PROFILE",
    "REPAIRED",
    "STEP_NS",
    "Contents",
    "Record",
    "RecordingError",
    "RecordingWriter",
    "WholeReads",
    "clock_set_back",
    "closed_span",
    "contents",
    "descriptors",
    "first_time",
    "is_complete",
    "message_count",
    "parts",
    "read",
    "read_metadata",
    "stamp_of",
]
