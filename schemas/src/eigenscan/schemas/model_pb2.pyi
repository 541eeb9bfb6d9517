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

class RegionModel(_message.Message):
    __slots__ = ("format", "region", "version", "frame_id", "spacing", "origin_x", "origin_y", "beams", "index_x", "index_y", "panoramas", "range_unit", "sensor", "range_cap", "mean", "eigenvectors", "eigenvalues", "total_variance", "outline_x", "outline_y", "space")
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    REGION_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    SPACING_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_X_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_Y_FIELD_NUMBER: _ClassVar[int]
    BEAMS_FIELD_NUMBER: _ClassVar[int]
    INDEX_X_FIELD_NUMBER: _ClassVar[int]
    INDEX_Y_FIELD_NUMBER: _ClassVar[int]
    PANORAMAS_FIELD_NUMBER: _ClassVar[int]
    RANGE_UNIT_FIELD_NUMBER: _ClassVar[int]
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    RANGE_CAP_FIELD_NUMBER: _ClassVar[int]
    MEAN_FIELD_NUMBER: _ClassVar[int]
    EIGENVECTORS_FIELD_NUMBER: _ClassVar[int]
    EIGENVALUES_FIELD_NUMBER: _ClassVar[int]
    TOTAL_VARIANCE_FIELD_NUMBER: _ClassVar[int]
    OUTLINE_X_FIELD_NUMBER: _ClassVar[int]
    OUTLINE_Y_FIELD_NUMBER: _ClassVar[int]
    SPACE_FIELD_NUMBER: _ClassVar[int]
    format: int
    region: str
    version: str
    frame_id: str
    spacing: float
    origin_x: float
    origin_y: float
    beams: int
    index_x: _containers.RepeatedScalarFieldContainer[int]
    index_y: _containers.RepeatedScalarFieldContainer[int]
    panoramas: bytes
    range_unit: float
    sensor: Sensor
    range_cap: float
    mean: float
    eigenvectors: _containers.RepeatedScalarFieldContainer[float]
    eigenvalues: _containers.RepeatedScalarFieldContainer[float]
    total_variance: float
    outline_x: _containers.RepeatedScalarFieldContainer[float]
    outline_y: _containers.RepeatedScalarFieldContainer[float]
    space: Eigenspace
    def __init__(self, format: _Optional[int] = ..., region: _Optional[str] = ..., version: _Optional[str] = ..., frame_id: _Optional[str] = ..., spacing: _Optional[float] = ..., origin_x: _Optional[float] = ..., origin_y: _Optional[float] = ..., beams: _Optional[int] = ..., index_x: _Optional[_Iterable[int]] = ..., index_y: _Optional[_Iterable[int]] = ..., panoramas: _Optional[bytes] = ..., range_unit: _Optional[float] = ..., sensor: _Optional[_Union[Sensor, _Mapping]] = ..., range_cap: _Optional[float] = ..., mean: _Optional[float] = ..., eigenvectors: _Optional[_Iterable[float]] = ..., eigenvalues: _Optional[_Iterable[float]] = ..., total_variance: _Optional[float] = ..., outline_x: _Optional[_Iterable[float]] = ..., outline_y: _Optional[_Iterable[float]] = ..., space: _Optional[_Union[Eigenspace, _Mapping]] = ...) -> None: ...

class Sensor(_message.Message):
    __slots__ = ("angle_min", "angle_increment", "beams", "range_max")
    ANGLE_MIN_FIELD_NUMBER: _ClassVar[int]
    ANGLE_INCREMENT_FIELD_NUMBER: _ClassVar[int]
    BEAMS_FIELD_NUMBER: _ClassVar[int]
    RANGE_MAX_FIELD_NUMBER: _ClassVar[int]
    angle_min: float
    angle_increment: float
    beams: int
    range_max: float
    def __init__(self, angle_min: _Optional[float] = ..., angle_increment: _Optional[float] = ..., beams: _Optional[int] = ..., range_max: _Optional[float] = ...) -> None: ...

class Eigenspace(_message.Message):
    __slots__ = ("embedding", "cap", "turn", "beams", "mean", "vectors", "eigenvalues", "total_variance", "usual_error")
    class Embedding(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        EMBEDDING_UNSPECIFIED: _ClassVar[Eigenspace.Embedding]
        EMBEDDING_RING: _ClassVar[Eigenspace.Embedding]
        EMBEDDING_RANGE: _ClassVar[Eigenspace.Embedding]
    EMBEDDING_UNSPECIFIED: Eigenspace.Embedding
    EMBEDDING_RING: Eigenspace.Embedding
    EMBEDDING_RANGE: Eigenspace.Embedding
    EMBEDDING_FIELD_NUMBER: _ClassVar[int]
    CAP_FIELD_NUMBER: _ClassVar[int]
    TURN_FIELD_NUMBER: _ClassVar[int]
    BEAMS_FIELD_NUMBER: _ClassVar[int]
    MEAN_FIELD_NUMBER: _ClassVar[int]
    VECTORS_FIELD_NUMBER: _ClassVar[int]
    EIGENVALUES_FIELD_NUMBER: _ClassVar[int]
    TOTAL_VARIANCE_FIELD_NUMBER: _ClassVar[int]
    USUAL_ERROR_FIELD_NUMBER: _ClassVar[int]
    embedding: Eigenspace.Embedding
    cap: float
    turn: int
    beams: int
    mean: _containers.RepeatedScalarFieldContainer[float]
    vectors: _containers.RepeatedScalarFieldContainer[float]
    eigenvalues: _containers.RepeatedScalarFieldContainer[float]
    total_variance: float
    usual_error: float
    def __init__(self, embedding: _Optional[_Union[Eigenspace.Embedding, str]] = ..., cap: _Optional[float] = ..., turn: _Optional[int] = ..., beams: _Optional[int] = ..., mean: _Optional[_Iterable[float]] = ..., vectors: _Optional[_Iterable[float]] = ..., eigenvalues: _Optional[_Iterable[float]] = ..., total_variance: _Optional[float] = ..., usual_error: _Optional[float] = ...) -> None: ...

class LidarKind(_message.Message):
    __slots__ = ("timestamp", "beams", "cap", "model_version")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    BEAMS_FIELD_NUMBER: _ClassVar[int]
    CAP_FIELD_NUMBER: _ClassVar[int]
    MODEL_VERSION_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    beams: int
    cap: float
    model_version: str
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., beams: _Optional[int] = ..., cap: _Optional[float] = ..., model_version: _Optional[str] = ...) -> None: ...

class RegionSpace(_message.Message):
    __slots__ = ("region", "model_version", "space")
    REGION_FIELD_NUMBER: _ClassVar[int]
    MODEL_VERSION_FIELD_NUMBER: _ClassVar[int]
    SPACE_FIELD_NUMBER: _ClassVar[int]
    region: str
    model_version: str
    space: Eigenspace
    def __init__(self, region: _Optional[str] = ..., model_version: _Optional[str] = ..., space: _Optional[_Union[Eigenspace, _Mapping]] = ...) -> None: ...

class ModelSet(_message.Message):
    __slots__ = ("timestamp", "version", "frame_id", "map_version", "entries", "free_area_m2", "floors")
    class Entry(_message.Message):
        __slots__ = ("region", "version", "size", "walls_in_sight")
        REGION_FIELD_NUMBER: _ClassVar[int]
        VERSION_FIELD_NUMBER: _ClassVar[int]
        SIZE_FIELD_NUMBER: _ClassVar[int]
        WALLS_IN_SIGHT_FIELD_NUMBER: _ClassVar[int]
        region: str
        version: str
        size: int
        walls_in_sight: float
        def __init__(self, region: _Optional[str] = ..., version: _Optional[str] = ..., size: _Optional[int] = ..., walls_in_sight: _Optional[float] = ...) -> None: ...
    class Floor(_message.Message):
        __slots__ = ("name", "origin", "outline_x", "outline_y")
        NAME_FIELD_NUMBER: _ClassVar[int]
        ORIGIN_FIELD_NUMBER: _ClassVar[int]
        OUTLINE_X_FIELD_NUMBER: _ClassVar[int]
        OUTLINE_Y_FIELD_NUMBER: _ClassVar[int]
        name: str
        origin: _geometry_pb2.Pose2
        outline_x: _containers.RepeatedScalarFieldContainer[float]
        outline_y: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, name: _Optional[str] = ..., origin: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., outline_x: _Optional[_Iterable[float]] = ..., outline_y: _Optional[_Iterable[float]] = ...) -> None: ...
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    ENTRIES_FIELD_NUMBER: _ClassVar[int]
    FREE_AREA_M2_FIELD_NUMBER: _ClassVar[int]
    FLOORS_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    version: str
    frame_id: str
    map_version: str
    entries: _containers.RepeatedCompositeFieldContainer[ModelSet.Entry]
    free_area_m2: float
    floors: _containers.RepeatedCompositeFieldContainer[ModelSet.Floor]
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., version: _Optional[str] = ..., frame_id: _Optional[str] = ..., map_version: _Optional[str] = ..., entries: _Optional[_Iterable[_Union[ModelSet.Entry, _Mapping]]] = ..., free_area_m2: _Optional[float] = ..., floors: _Optional[_Iterable[_Union[ModelSet.Floor, _Mapping]]] = ...) -> None: ...
