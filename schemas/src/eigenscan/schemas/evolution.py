"""Holds the contract to its promise: fields are only added.

`python -m eigenscan.schemas.evolution BASELINE [--check]` compares the messages of today with those in
BASELINE, a FileDescriptorSet. A break is an error; what was added is written to BASELINE, or with
`--check` is an error too.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from eigenscan.schemas.channels import CHANNELS
from eigenscan.schemas.localize_pb2 import LocalizeQuery
from eigenscan.schemas.recordings_pb2 import RecordingParts
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorSet,
)

_OWN = "eigenscan."


def contract() -> FileDescriptorSet:
    """Our own .proto files behind channels and queries, with all that they import, in a fixed order."""
    files: dict[str, Any] = {}

    def visit(file: Any) -> None:
        for needed in file.dependencies:
            visit(needed)
        if file.package == _OWN.rstrip("."):
            files[file.name] = file

    for channel in CHANNELS:
        visit(channel.message.DESCRIPTOR.file)
    for asked in (LocalizeQuery, RecordingParts):
        visit(asked.DESCRIPTOR.file)
    result = FileDescriptorSet()
    for name in sorted(files):
        files[name].CopyToProto(result.file.add())
    return result


def breaks(earlier: FileDescriptorSet, later: FileDescriptorSet) -> list[str]:
    """Removed or changed parts of `earlier`: a line for each field or enum value."""
    before, now = dict(_entries(earlier)), dict(_entries(later))
    found = []
    for (place, number), meaning in before.items():
        line = f"{place}.{meaning[0]} = {number}"
        if (place, number) not in now:
            found.append(f"{line} vanished")
        elif now[place, number] != meaning:
            after = now[place, number]
            found.append(f"{line} is now {' '.join(after if after[0] == meaning[0] else after[:1])}")
    return found


def _entries(files: FileDescriptorSet) -> Iterator[tuple[tuple[str, int], tuple[str, ...]]]:
    """((message or enum, number), (name, type, label)) of every field and enum value."""
    for file in files.file:
        for enum in file.enum_type:
            yield from _enum_entries(enum, f"{file.package}.")
        for message in file.message_type:
            yield from _message_entries(message, f"{file.package}.")


def _message_entries(
    message: DescriptorProto, prefix: str
) -> Iterator[tuple[tuple[str, int], tuple[str, ...]]]:
    place = prefix + message.name
    for field in message.field:
        kind = field.type_name or FieldDescriptorProto.Type.Name(field.type)
        label = FieldDescriptorProto.Label.Name(field.label)
        if field.HasField("oneof_index"):  # `optional` is a oneof of one: 0 is then not the same as nothing
            label += f" of {message.oneof_decl[field.oneof_index].name}"
        yield (place, field.number), (field.name, kind, label)
    for enum in message.enum_type:
        yield from _enum_entries(enum, f"{place}.")
    for nested in message.nested_type:
        yield from _message_entries(nested, f"{place}.")


def _enum_entries(
    enum: EnumDescriptorProto, prefix: str
) -> Iterator[tuple[tuple[str, int], tuple[str, ...]]]:
    for value in enum.value:
        yield (prefix + enum.name, value.number), (value.name, "", "")


def main(arguments: list[str]) -> int:
    """Compares with the baseline that `arguments` name, and brings it up to date; gives the exit code."""
    path = Path(arguments[0])
    today = contract()
    baseline = FileDescriptorSet.FromString(path.read_bytes()) if path.exists() else FileDescriptorSet()
    found = breaks(baseline, today)
    if found:
        print(*found, "schemas: fields are only added; see docs/contract.md", sep="\n", file=sys.stderr)
        return 1
    if breaks(today, baseline):
        if "--check" in arguments:
            print(f"schemas: {path} is not current: run tools/generate-contract", file=sys.stderr)
            return 1
        path.write_bytes(today.SerializeToString(deterministic=True))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
