import datetime

from eigenscan.schemas import geometry_pb2 as _geometry_pb2
from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STATE_UNSPECIFIED: _ClassVar[State]
    STATE_LOST: _ClassVar[State]
    STATE_AMBIGUOUS: _ClassVar[State]
    STATE_LOCALIZED: _ClassVar[State]
STATE_UNSPECIFIED: State
STATE_LOST: State
STATE_AMBIGUOUS: State
STATE_LOCALIZED: State

class PoseEstimate(_message.Message):
    __slots__ = ("timestamp", "frame_id", "child_frame_id", "pose", "covariance", "state", "confidence", "none_probability", "map_to_odom", "has_odometry", "model_version", "track_id", "protection_radius", "protection_angle", "protection_risk", "floor", "floor_pose", "extrapolated")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    CHILD_FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    NONE_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    MAP_TO_ODOM_FIELD_NUMBER: _ClassVar[int]
    HAS_ODOMETRY_FIELD_NUMBER: _ClassVar[int]
    MODEL_VERSION_FIELD_NUMBER: _ClassVar[int]
    TRACK_ID_FIELD_NUMBER: _ClassVar[int]
    PROTECTION_RADIUS_FIELD_NUMBER: _ClassVar[int]
    PROTECTION_ANGLE_FIELD_NUMBER: _ClassVar[int]
    PROTECTION_RISK_FIELD_NUMBER: _ClassVar[int]
    FLOOR_FIELD_NUMBER: _ClassVar[int]
    FLOOR_POSE_FIELD_NUMBER: _ClassVar[int]
    EXTRAPOLATED_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    child_frame_id: str
    pose: _geometry_pb2.Pose2
    covariance: _geometry_pb2.Covariance3
    state: State
    confidence: float
    none_probability: float
    map_to_odom: _geometry_pb2.Pose2
    has_odometry: bool
    model_version: str
    track_id: int
    protection_radius: float
    protection_angle: float
    protection_risk: float
    floor: str
    floor_pose: _geometry_pb2.Pose2
    extrapolated: bool
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., child_frame_id: _Optional[str] = ..., pose: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., covariance: _Optional[_Union[_geometry_pb2.Covariance3, _Mapping]] = ..., state: _Optional[_Union[State, str]] = ..., confidence: _Optional[float] = ..., none_probability: _Optional[float] = ..., map_to_odom: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., has_odometry: _Optional[bool] = ..., model_version: _Optional[str] = ..., track_id: _Optional[int] = ..., protection_radius: _Optional[float] = ..., protection_angle: _Optional[float] = ..., protection_risk: _Optional[float] = ..., floor: _Optional[str] = ..., floor_pose: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., extrapolated: _Optional[bool] = ...) -> None: ...

class Track(_message.Message):
    __slots__ = ("id", "parent_id", "pose", "covariance", "probability", "observations", "age", "history", "nis")
    ID_FIELD_NUMBER: _ClassVar[int]
    PARENT_ID_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    AGE_FIELD_NUMBER: _ClassVar[int]
    HISTORY_FIELD_NUMBER: _ClassVar[int]
    NIS_FIELD_NUMBER: _ClassVar[int]
    id: int
    parent_id: int
    pose: _geometry_pb2.Pose2
    covariance: _geometry_pb2.Covariance3
    probability: float
    observations: int
    age: float
    history: _containers.RepeatedCompositeFieldContainer[_geometry_pb2.Pose2]
    nis: float
    def __init__(self, id: _Optional[int] = ..., parent_id: _Optional[int] = ..., pose: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., covariance: _Optional[_Union[_geometry_pb2.Covariance3, _Mapping]] = ..., probability: _Optional[float] = ..., observations: _Optional[int] = ..., age: _Optional[float] = ..., history: _Optional[_Iterable[_Union[_geometry_pb2.Pose2, _Mapping]]] = ..., nis: _Optional[float] = ...) -> None: ...

class Tracks(_message.Message):
    __slots__ = ("timestamp", "frame_id", "tracks", "none_probability", "state")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    TRACKS_FIELD_NUMBER: _ClassVar[int]
    NONE_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    tracks: _containers.RepeatedCompositeFieldContainer[Track]
    none_probability: float
    state: State
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., tracks: _Optional[_Iterable[_Union[Track, _Mapping]]] = ..., none_probability: _Optional[float] = ..., state: _Optional[_Union[State, str]] = ...) -> None: ...

class Relocation(_message.Message):
    __slots__ = ("timestamp", "frame_id", "pose", "covariance")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    pose: _geometry_pb2.Pose2
    covariance: _geometry_pb2.Covariance3
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., pose: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., covariance: _Optional[_Union[_geometry_pb2.Covariance3, _Mapping]] = ...) -> None: ...
