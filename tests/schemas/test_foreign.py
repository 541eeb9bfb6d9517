"""foxglove's .proto files beside ours: what protoc makes of them is what the package has."""

from pathlib import Path

import grpc_tools
import pytest
from eigenscan.schemas.channels import CHANNELS
from eigenscan.schemas.foreign import files, main
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import Default
from grpc_tools import protoc

from tests.environment import ROOT

PROTO = ROOT / "schemas/proto"
GOOGLE = Path(grpc_tools.__file__).with_name("_proto")
"""google's own files, which protoc as a program finds by itself."""


def compiled(folder: Path, out: Path, *names: str) -> dict[str, FileDescriptorProto]:
    assert protoc.main(["protoc", f"-I{folder}", f"-I{GOOGLE}", f"--descriptor_set_out={out}", *names]) == 0
    return {file.name: file for file in FileDescriptorSet.FromString(out.read_bytes()).file}


def test_protoc_makes_of_them_what_the_package_has(tmp_path: Path) -> None:
    names = sorted(files())
    for name, ours in compiled(PROTO, tmp_path / "set", *names).items():
        theirs = FileDescriptorProto()
        Default().FindFileByName(name).CopyToProto(theirs)
        for file in (ours, theirs):
            for message in file.message_type:
                for field in message.field:
                    field.ClearField("json_name")  # which protoc works out by itself
        assert ours == theirs, name


def test_the_folder_compiles_with_nothing_else(tmp_path: Path) -> None:
    """google's own timestamp comes with every protoc."""
    every = sorted(str(path.relative_to(PROTO)) for path in PROTO.rglob("*.proto"))
    found = compiled(PROTO, tmp_path / "set", *every)
    messages = {f"{file.package}.{message.name}" for file in found.values() for message in file.message_type}
    assert {channel.schema_name for channel in CHANNELS} <= messages


def test_files_that_are_not_current_are_noticed_and_mended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(PROTO), "--check"]) == 0
    assert main([str(tmp_path)]) == 0
    stale = tmp_path / "foxglove/Odometry.proto"
    stale.write_text(stale.read_text().replace("= 4;", "= 5;"))
    (tmp_path / "foxglove/Gone.proto").write_text("")
    assert main([str(tmp_path), "--check"]) == 1
    assert "tools/generate-contract" in capsys.readouterr().err
    assert main([str(tmp_path)]) == 0
    assert {
        str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*.proto")
    } == files()
