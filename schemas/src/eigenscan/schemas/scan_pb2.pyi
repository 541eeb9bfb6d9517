import datetime

from eigenscan.schemas import geometry_pb2 as _geometry_pb2
from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RawScan(_message.Message):
    __slots__ = ("timestamp", "frame_id", "mount", "upside_down", "angle_min", "angle_increment", "range_min", "range_max", "ranges", "time_increment", "stamped_after", "gathered")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    MOUNT_FIELD_NUMBER: _ClassVar[int]
    UPSIDE_DOWN_FIELD_NUMBER: _ClassVar[int]
    ANGLE_MIN_FIELD_NUMBER: _ClassVar[int]
    ANGLE_INCREMENT_FIELD_NUMBER: _ClassVar[int]
    RANGE_MIN_FIELD_NUMBER: _ClassVar[int]
    RANGE_MAX_FIELD_NUMBER: _ClassVar[int]
    RANGES_FIELD_NUMBER: _ClassVar[int]
    TIME_INCREMENT_FIELD_NUMBER: _ClassVar[int]
    STAMPED_AFTER_FIELD_NUMBER: _ClassVar[int]
    GATHERED_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    mount: _geometry_pb2.Pose2
    upside_down: bool
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: _containers.RepeatedScalarFieldContainer[float]
    time_increment: float
    stamped_after: float
    gathered: float
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., mount: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., upside_down: _Optional[bool] = ..., angle_min: _Optional[float] = ..., angle_increment: _Optional[float] = ..., range_min: _Optional[float] = ..., range_max: _Optional[float] = ..., ranges: _Optional[_Iterable[float]] = ..., time_increment: _Optional[float] = ..., stamped_after: _Optional[float] = ..., gathered: _Optional[float] = ...) -> None: ...

class Scan(_message.Message):
    __slots__ = ("timestamp", "frame_id", "mount", "angle_min", "angle_increment", "range_min", "range_max", "ranges", "sequence", "motion", "gathered")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    MOUNT_FIELD_NUMBER: _ClassVar[int]
    ANGLE_MIN_FIELD_NUMBER: _ClassVar[int]
    ANGLE_INCREMENT_FIELD_NUMBER: _ClassVar[int]
    RANGE_MIN_FIELD_NUMBER: _ClassVar[int]
    RANGE_MAX_FIELD_NUMBER: _ClassVar[int]
    RANGES_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    MOTION_FIELD_NUMBER: _ClassVar[int]
    GATHERED_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    mount: _geometry_pb2.Pose2
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: _containers.RepeatedScalarFieldContainer[float]
    sequence: int
    motion: ScanMotion
    gathered: float
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., mount: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., angle_min: _Optional[float] = ..., angle_increment: _Optional[float] = ..., range_min: _Optional[float] = ..., range_max: _Optional[float] = ..., ranges: _Optional[_Iterable[float]] = ..., sequence: _Optional[int] = ..., motion: _Optional[_Union[ScanMotion, _Mapping]] = ..., gathered: _Optional[float] = ...) -> None: ...

class ScanMotion(_message.Message):
    __slots__ = ("timestamp", "since", "motion", "covariance", "explained", "repeats", "longest_step", "watched")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    SINCE_FIELD_NUMBER: _ClassVar[int]
    MOTION_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    EXPLAINED_FIELD_NUMBER: _ClassVar[int]
    REPEATS_FIELD_NUMBER: _ClassVar[int]
    LONGEST_STEP_FIELD_NUMBER: _ClassVar[int]
    WATCHED_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    since: _timestamp_pb2.Timestamp
    motion: _geometry_pb2.Pose2
    covariance: _geometry_pb2.Covariance3
    explained: float
    repeats: int
    longest_step: float
    watched: bool
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., since: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., motion: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., covariance: _Optional[_Union[_geometry_pb2.Covariance3, _Mapping]] = ..., explained: _Optional[float] = ..., repeats: _Optional[int] = ..., longest_step: _Optional[float] = ..., watched: _Optional[bool] = ...) -> None: ...
