"""Hypothesis strategies for whole messages, made from their descriptors."""

from collections.abc import Callable
from typing import Any

import pytest
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from hypothesis import strategies as st

_SCALARS: dict[int, st.SearchStrategy[Any]] = {
    FieldDescriptor.CPPTYPE_DOUBLE: st.floats(),
    FieldDescriptor.CPPTYPE_FLOAT: st.floats(width=32),
    FieldDescriptor.CPPTYPE_BOOL: st.booleans(),
    FieldDescriptor.CPPTYPE_INT32: st.integers(-(2**31), 2**31 - 1),
    FieldDescriptor.CPPTYPE_UINT32: st.integers(0, 2**32 - 1),
    FieldDescriptor.CPPTYPE_INT64: st.integers(-(2**63), 2**63 - 1),
    FieldDescriptor.CPPTYPE_UINT64: st.integers(0, 2**64 - 1),
}
_TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)


def _values(field: FieldDescriptor) -> st.SearchStrategy[Any]:
    if field.cpp_type == FieldDescriptor.CPPTYPE_MESSAGE:
        assert field.message_type is not None
        return _messages(field.message_type)
    if field.cpp_type == FieldDescriptor.CPPTYPE_ENUM:
        assert field.enum_type is not None
        return st.sampled_from([value.number for value in field.enum_type.values])
    if field.type == FieldDescriptor.TYPE_BYTES:
        return st.binary(max_size=16)
    return _TEXT if field.cpp_type == FieldDescriptor.CPPTYPE_STRING else _SCALARS[field.cpp_type]


def _filled(field: FieldDescriptor) -> st.SearchStrategy[Any]:
    if not field.is_repeated:
        return _values(field)
    if field.message_type is not None and field.message_type.GetOptions().map_entry:
        parts = field.message_type.fields_by_name
        return st.dictionaries(_values(parts["key"]), _values(parts["value"]), max_size=4)
    return st.lists(_values(field), max_size=3)


def _messages(descriptor: Any) -> st.SearchStrategy[Message]:
    kind = GetMessageClass(descriptor)
    fields = {field.name: _filled(field) for field in descriptor.fields}
    if descriptor.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
        fields = {"seconds": st.integers(0, 2**33), "nanos": st.integers(0, 10**9 - 1)}
    return st.fixed_dictionaries({}, optional=fields).map(lambda values: kind(**values))


@pytest.fixture(scope="session")
def messages() -> Callable[[type[Message]], st.SearchStrategy[Message]]:
    """Strategy for messages of a kind, any field set to anything it can hold."""
    return lambda kind: _messages(kind.DESCRIPTOR)
