import datetime

from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Advice(_message.Message):
    __slots__ = ("timestamp", "frame_id", "kind", "heading", "distance", "way", "track_ids", "probability", "probability_now", "evidence", "reach")
    class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        KIND_UNSPECIFIED: _ClassVar[Advice.Kind]
        KIND_MOVE: _ClassVar[Advice.Kind]
        KIND_NOTHING: _ClassVar[Advice.Kind]
    KIND_UNSPECIFIED: Advice.Kind
    KIND_MOVE: Advice.Kind
    KIND_NOTHING: Advice.Kind
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_FIELD_NUMBER: _ClassVar[int]
    WAY_FIELD_NUMBER: _ClassVar[int]
    TRACK_IDS_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_NOW_FIELD_NUMBER: _ClassVar[int]
    EVIDENCE_FIELD_NUMBER: _ClassVar[int]
    REACH_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    kind: Advice.Kind
    heading: float
    distance: float
    way: float
    track_ids: _containers.RepeatedScalarFieldContainer[int]
    probability: float
    probability_now: float
    evidence: float
    reach: float
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., kind: _Optional[_Union[Advice.Kind, str]] = ..., heading: _Optional[float] = ..., distance: _Optional[float] = ..., way: _Optional[float] = ..., track_ids: _Optional[_Iterable[int]] = ..., probability: _Optional[float] = ..., probability_now: _Optional[float] = ..., evidence: _Optional[float] = ..., reach: _Optional[float] = ...) -> None: ...
