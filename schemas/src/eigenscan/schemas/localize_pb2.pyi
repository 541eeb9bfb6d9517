import datetime

from eigenscan.schemas import geometry_pb2 as _geometry_pb2
from eigenscan.schemas import hypotheses_pb2 as _hypotheses_pb2
from eigenscan.schemas import scan_pb2 as _scan_pb2
from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class LocalizeQuery(_message.Message):
    __slots__ = ("scan", "near", "radius", "turn", "floor", "region", "most")
    SCAN_FIELD_NUMBER: _ClassVar[int]
    NEAR_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    TURN_FIELD_NUMBER: _ClassVar[int]
    FLOOR_FIELD_NUMBER: _ClassVar[int]
    REGION_FIELD_NUMBER: _ClassVar[int]
    MOST_FIELD_NUMBER: _ClassVar[int]
    scan: _scan_pb2.RawScan
    near: _geometry_pb2.Pose2
    radius: float
    turn: float
    floor: str
    region: str
    most: int
    def __init__(self, scan: _Optional[_Union[_scan_pb2.RawScan, _Mapping]] = ..., near: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., radius: _Optional[float] = ..., turn: _Optional[float] = ..., floor: _Optional[str] = ..., region: _Optional[str] = ..., most: _Optional[int] = ...) -> None: ...

class LocalizeReply(_message.Message):
    __slots__ = ("timestamp", "frame_id", "status", "candidates", "none_probability", "searched_area_m2", "asked_area_m2", "model_version")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    CANDIDATES_FIELD_NUMBER: _ClassVar[int]
    NONE_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    SEARCHED_AREA_M2_FIELD_NUMBER: _ClassVar[int]
    ASKED_AREA_M2_FIELD_NUMBER: _ClassVar[int]
    MODEL_VERSION_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    status: _hypotheses_pb2.Hypotheses.Status
    candidates: _containers.RepeatedCompositeFieldContainer[LocalizeCandidate]
    none_probability: float
    searched_area_m2: float
    asked_area_m2: float
    model_version: str
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., status: _Optional[_Union[_hypotheses_pb2.Hypotheses.Status, str]] = ..., candidates: _Optional[_Iterable[_Union[LocalizeCandidate, _Mapping]]] = ..., none_probability: _Optional[float] = ..., searched_area_m2: _Optional[float] = ..., asked_area_m2: _Optional[float] = ..., model_version: _Optional[str] = ...) -> None: ...

class LocalizeCandidate(_message.Message):
    __slots__ = ("pose", "covariance", "log_likelihood", "probability", "region", "floor", "floor_pose")
    POSE_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    LOG_LIKELIHOOD_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    REGION_FIELD_NUMBER: _ClassVar[int]
    FLOOR_FIELD_NUMBER: _ClassVar[int]
    FLOOR_POSE_FIELD_NUMBER: _ClassVar[int]
    pose: _geometry_pb2.Pose2
    covariance: _geometry_pb2.Covariance3
    log_likelihood: float
    probability: float
    region: str
    floor: str
    floor_pose: _geometry_pb2.Pose2
    def __init__(self, pose: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., covariance: _Optional[_Union[_geometry_pb2.Covariance3, _Mapping]] = ..., log_likelihood: _Optional[float] = ..., probability: _Optional[float] = ..., region: _Optional[str] = ..., floor: _Optional[str] = ..., floor_pose: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ...) -> None: ...
