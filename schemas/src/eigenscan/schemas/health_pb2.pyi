import datetime

from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Health(_message.Message):
    __slots__ = ("timestamp", "service", "instance", "status", "detail", "counters", "package_version", "settings")
    class Status(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STATUS_UNSPECIFIED: _ClassVar[Health.Status]
        STATUS_OK: _ClassVar[Health.Status]
        STATUS_WAITING: _ClassVar[Health.Status]
        STATUS_DEGRADED: _ClassVar[Health.Status]
    STATUS_UNSPECIFIED: Health.Status
    STATUS_OK: Health.Status
    STATUS_WAITING: Health.Status
    STATUS_DEGRADED: Health.Status
    class CountersEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    SERVICE_FIELD_NUMBER: _ClassVar[int]
    INSTANCE_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    PACKAGE_VERSION_FIELD_NUMBER: _ClassVar[int]
    SETTINGS_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    service: str
    instance: str
    status: Health.Status
    detail: str
    counters: _containers.ScalarMap[str, int]
    package_version: str
    settings: str
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., service: _Optional[str] = ..., instance: _Optional[str] = ..., status: _Optional[_Union[Health.Status, str]] = ..., detail: _Optional[str] = ..., counters: _Optional[_Mapping[str, int]] = ..., package_version: _Optional[str] = ..., settings: _Optional[str] = ...) -> None: ...
