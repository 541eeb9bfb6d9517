import datetime

from eigenscan.schemas import geometry_pb2 as _geometry_pb2
from eigenscan.schemas import scan_pb2 as _scan_pb2
from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Search(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SEARCH_UNSPECIFIED: _ClassVar[Search]
    SEARCH_WHOLE: _ClassVar[Search]
    SEARCH_LOCAL: _ClassVar[Search]

class Surfaces(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SURFACES_UNSPECIFIED: _ClassVar[Surfaces]
    SURFACES_MIDDLE: _ClassVar[Surfaces]
    SURFACES_FACES: _ClassVar[Surfaces]
SEARCH_UNSPECIFIED: Search
SEARCH_WHOLE: Search
SEARCH_LOCAL: Search
SURFACES_UNSPECIFIED: Surfaces
SURFACES_MIDDLE: Surfaces
SURFACES_FACES: Surfaces

class Hypothesis(_message.Message):
    __slots__ = ("pose", "covariance", "log_likelihood", "region", "error_energy", "explained", "coefficients")
    POSE_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    LOG_LIKELIHOOD_FIELD_NUMBER: _ClassVar[int]
    REGION_FIELD_NUMBER: _ClassVar[int]
    ERROR_ENERGY_FIELD_NUMBER: _ClassVar[int]
    EXPLAINED_FIELD_NUMBER: _ClassVar[int]
    COEFFICIENTS_FIELD_NUMBER: _ClassVar[int]
    pose: _geometry_pb2.Pose2
    covariance: _geometry_pb2.Covariance3
    log_likelihood: float
    region: str
    error_energy: float
    explained: float
    coefficients: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, pose: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., covariance: _Optional[_Union[_geometry_pb2.Covariance3, _Mapping]] = ..., log_likelihood: _Optional[float] = ..., region: _Optional[str] = ..., error_energy: _Optional[float] = ..., explained: _Optional[float] = ..., coefficients: _Optional[_Iterable[float]] = ...) -> None: ...

class Projection(_message.Message):
    __slots__ = ("region", "coefficients", "error_energy", "searched")
    REGION_FIELD_NUMBER: _ClassVar[int]
    COEFFICIENTS_FIELD_NUMBER: _ClassVar[int]
    ERROR_ENERGY_FIELD_NUMBER: _ClassVar[int]
    SEARCHED_FIELD_NUMBER: _ClassVar[int]
    region: str
    coefficients: _containers.RepeatedScalarFieldContainer[float]
    error_energy: float
    searched: bool
    def __init__(self, region: _Optional[str] = ..., coefficients: _Optional[_Iterable[float]] = ..., error_energy: _Optional[float] = ..., searched: _Optional[bool] = ...) -> None: ...

class SearchRequest(_message.Message):
    __slots__ = ("timestamp", "frame_id", "search", "pose", "covariance", "velocity", "least_log_likelihood", "places")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    SEARCH_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    LEAST_LOG_LIKELIHOOD_FIELD_NUMBER: _ClassVar[int]
    PLACES_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    search: Search
    pose: _geometry_pb2.Pose2
    covariance: _geometry_pb2.Covariance3
    velocity: _geometry_pb2.Pose2
    least_log_likelihood: float
    places: _containers.RepeatedCompositeFieldContainer[_geometry_pb2.Pose2]
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., search: _Optional[_Union[Search, str]] = ..., pose: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., covariance: _Optional[_Union[_geometry_pb2.Covariance3, _Mapping]] = ..., velocity: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., least_log_likelihood: _Optional[float] = ..., places: _Optional[_Iterable[_Union[_geometry_pb2.Pose2, _Mapping]]] = ...) -> None: ...

class RangeError(_message.Message):
    __slots__ = ("factor", "offset", "gain", "apart", "mirrored", "searched")
    FACTOR_FIELD_NUMBER: _ClassVar[int]
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    GAIN_FIELD_NUMBER: _ClassVar[int]
    APART_FIELD_NUMBER: _ClassVar[int]
    MIRRORED_FIELD_NUMBER: _ClassVar[int]
    SEARCHED_FIELD_NUMBER: _ClassVar[int]
    factor: float
    offset: float
    gain: float
    apart: float
    mirrored: bool
    searched: bool
    def __init__(self, factor: _Optional[float] = ..., offset: _Optional[float] = ..., gain: _Optional[float] = ..., apart: _Optional[float] = ..., mirrored: _Optional[bool] = ..., searched: _Optional[bool] = ...) -> None: ...

class RangeCheck(_message.Message):
    __slots__ = ("errors",)
    ERRORS_FIELD_NUMBER: _ClassVar[int]
    errors: _containers.RepeatedCompositeFieldContainer[RangeError]
    def __init__(self, errors: _Optional[_Iterable[_Union[RangeError, _Mapping]]] = ...) -> None: ...

class Hypotheses(_message.Message):
    __slots__ = ("timestamp", "frame_id", "status", "hypotheses", "unlisted_log_likelihood", "searched_area_m2", "model_version", "used_beams", "projections", "motion", "search", "surfaces", "range_check", "cut", "inexactness", "gathered")
    class Status(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STATUS_UNSPECIFIED: _ClassVar[Hypotheses.Status]
        STATUS_OK: _ClassVar[Hypotheses.Status]
        STATUS_UNUSABLE_SCAN: _ClassVar[Hypotheses.Status]
    STATUS_UNSPECIFIED: Hypotheses.Status
    STATUS_OK: Hypotheses.Status
    STATUS_UNUSABLE_SCAN: Hypotheses.Status
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    HYPOTHESES_FIELD_NUMBER: _ClassVar[int]
    UNLISTED_LOG_LIKELIHOOD_FIELD_NUMBER: _ClassVar[int]
    SEARCHED_AREA_M2_FIELD_NUMBER: _ClassVar[int]
    MODEL_VERSION_FIELD_NUMBER: _ClassVar[int]
    USED_BEAMS_FIELD_NUMBER: _ClassVar[int]
    PROJECTIONS_FIELD_NUMBER: _ClassVar[int]
    MOTION_FIELD_NUMBER: _ClassVar[int]
    SEARCH_FIELD_NUMBER: _ClassVar[int]
    SURFACES_FIELD_NUMBER: _ClassVar[int]
    RANGE_CHECK_FIELD_NUMBER: _ClassVar[int]
    CUT_FIELD_NUMBER: _ClassVar[int]
    INEXACTNESS_FIELD_NUMBER: _ClassVar[int]
    GATHERED_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    status: Hypotheses.Status
    hypotheses: _containers.RepeatedCompositeFieldContainer[Hypothesis]
    unlisted_log_likelihood: float
    searched_area_m2: float
    model_version: str
    used_beams: int
    projections: _containers.RepeatedCompositeFieldContainer[Projection]
    motion: _scan_pb2.ScanMotion
    search: Search
    surfaces: Surfaces
    range_check: RangeCheck
    cut: bool
    inexactness: float
    gathered: float
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., status: _Optional[_Union[Hypotheses.Status, str]] = ..., hypotheses: _Optional[_Iterable[_Union[Hypothesis, _Mapping]]] = ..., unlisted_log_likelihood: _Optional[float] = ..., searched_area_m2: _Optional[float] = ..., model_version: _Optional[str] = ..., used_beams: _Optional[int] = ..., projections: _Optional[_Iterable[_Union[Projection, _Mapping]]] = ..., motion: _Optional[_Union[_scan_pb2.ScanMotion, _Mapping]] = ..., search: _Optional[_Union[Search, str]] = ..., surfaces: _Optional[_Union[Surfaces, str]] = ..., range_check: _Optional[_Union[RangeCheck, _Mapping]] = ..., cut: _Optional[bool] = ..., inexactness: _Optional[float] = ..., gathered: _Optional[float] = ...) -> None: ...

class Obstacles(_message.Message):
    __slots__ = ("timestamp", "frame_id", "pose", "mask", "error", "error_energy", "confidence", "sensor_x", "sensor_y", "map_x", "map_y", "model_version")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    ERROR_ENERGY_FIELD_NUMBER: _ClassVar[int]
    CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    SENSOR_X_FIELD_NUMBER: _ClassVar[int]
    SENSOR_Y_FIELD_NUMBER: _ClassVar[int]
    MAP_X_FIELD_NUMBER: _ClassVar[int]
    MAP_Y_FIELD_NUMBER: _ClassVar[int]
    MODEL_VERSION_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    frame_id: str
    pose: _geometry_pb2.Pose2
    mask: bytes
    error: _containers.RepeatedScalarFieldContainer[float]
    error_energy: float
    confidence: float
    sensor_x: _containers.RepeatedScalarFieldContainer[float]
    sensor_y: _containers.RepeatedScalarFieldContainer[float]
    map_x: _containers.RepeatedScalarFieldContainer[float]
    map_y: _containers.RepeatedScalarFieldContainer[float]
    model_version: str
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., frame_id: _Optional[str] = ..., pose: _Optional[_Union[_geometry_pb2.Pose2, _Mapping]] = ..., mask: _Optional[bytes] = ..., error: _Optional[_Iterable[float]] = ..., error_energy: _Optional[float] = ..., confidence: _Optional[float] = ..., sensor_x: _Optional[_Iterable[float]] = ..., sensor_y: _Optional[_Iterable[float]] = ..., map_x: _Optional[_Iterable[float]] = ..., map_y: _Optional[_Iterable[float]] = ..., model_version: _Optional[str] = ...) -> None: ...
