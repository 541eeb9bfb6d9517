from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Pose2(_message.Message):
    __slots__ = ("x", "y", "theta")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    THETA_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    theta: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., theta: _Optional[float] = ...) -> None: ...

class Covariance3(_message.Message):
    __slots__ = ("xx", "xy", "xt", "yy", "yt", "tt")
    XX_FIELD_NUMBER: _ClassVar[int]
    XY_FIELD_NUMBER: _ClassVar[int]
    XT_FIELD_NUMBER: _ClassVar[int]
    YY_FIELD_NUMBER: _ClassVar[int]
    YT_FIELD_NUMBER: _ClassVar[int]
    TT_FIELD_NUMBER: _ClassVar[int]
    xx: float
    xy: float
    xt: float
    yy: float
    yt: float
    tt: float
    def __init__(self, xx: _Optional[float] = ..., xy: _Optional[float] = ..., xt: _Optional[float] = ..., yy: _Optional[float] = ..., yt: _Optional[float] = ..., tt: _Optional[float] = ...) -> None: ...
