"""The .proto files of the messages that are not ours, written from the package that has them compiled.

`python -m eigenscan.schemas.foreign FOLDER [--check]` writes foxglove's behind our channels; with `--check` a
file that is not current is an error. The package carries no comments, so the files have none.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from eigenscan.schemas.channels import CHANNELS
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
)

DISTRIBUTION = "foxglove-schemas-protobuf"
FOREIGN = "foxglove"
"""The proto package that is written; google's own files come with every protoc."""

_HEAD = """\
// Foxglove schemas {version}, (c) Foxglove Technologies Inc, MIT licence.
// Made by tools/generate-contract from the package {distribution}.
// What each field means: https://docs.foxglove.dev/docs/sdk/schemas
"""
_REPEATED = FieldDescriptorProto.LABEL_REPEATED
_TYPES = {number: name.removeprefix("TYPE_").lower() for name, number in FieldDescriptorProto.Type.items()}


def files() -> dict[str, str]:
    """Path -> text of each foreign file that a channel's message needs."""
    found: dict[str, str] = {}

    def visit(file: Any) -> None:
        for needed in file.dependencies:
            visit(needed)
        if file.package == FOREIGN:
            described = FileDescriptorProto()
            file.CopyToProto(described)
            found[file.name] = text_of(described)

    for channel in CHANNELS:
        visit(channel.message.DESCRIPTOR.file)
    return found


def text_of(file: FileDescriptorProto) -> str:
    """The file as protoc reads it, of the proto3 that these use: no options, maps, oneofs, services."""
    head = _HEAD.format(version=version(DISTRIBUTION), distribution=DISTRIBUTION)
    lines = [f'syntax = "{file.syntax}";', f"package {file.package};"]
    if file.dependency:
        lines += ["", *(f'import "{needed}";' for needed in file.dependency)]
    for enum in file.enum_type:
        lines += ["", *_enum(enum)]
    for message in file.message_type:
        lines += ["", *_message(message)]
    return head + "\n".join(lines) + "\n"


def _message(message: DescriptorProto) -> Iterator[str]:
    yield f"message {message.name} {{"
    for enum in message.enum_type:
        yield from (f"  {line}" for line in _enum(enum))
    for nested in message.nested_type:
        yield from (f"  {line}" for line in _message(nested))
    for field in message.field:
        label = "repeated " if field.label == _REPEATED else "optional " if field.proto3_optional else ""
        kind = field.type_name or _TYPES[field.type]
        yield f"  {label}{kind} {field.name} = {field.number};"
    yield "}"


def _enum(enum: EnumDescriptorProto) -> Iterator[str]:
    yield f"enum {enum.name} {{"
    for value in enum.value:
        yield f"  {value.name} = {value.number};"
    yield "}"


def main(arguments: list[str]) -> int:
    """Brings the folder that `arguments` name up to date; gives the exit code."""
    folder, wanted = Path(arguments[0]), files()
    there = {
        str(path.relative_to(folder)): path.read_text(encoding="utf-8")
        for path in (folder / FOREIGN).glob("*.proto")
    }
    if there == wanted:
        return 0
    if "--check" in arguments:
        print(f"{folder / FOREIGN} is not current: run tools/generate-contract", file=sys.stderr)
        return 1
    for name in there.keys() - wanted.keys():
        (folder / name).unlink()
    for name, text in wanted.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
