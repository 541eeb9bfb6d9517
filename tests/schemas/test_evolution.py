"""What was once in the contract stays: schemas/baseline.binpb holds every field ever released."""

import copy
import subprocess
import sys
from pathlib import Path

import pytest
from eigenscan.schemas.evolution import breaks, contract
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorSet

from tests.environment import ROOT


@pytest.fixture
def today() -> FileDescriptorSet:
    return contract()


def _message(files: FileDescriptorSet, name: str) -> DescriptorProto:
    return next(one for file in files.file for one in file.message_type if one.name == name)


def test_nothing_of_the_baseline_has_changed(today: FileDescriptorSet) -> None:
    baseline = FileDescriptorSet.FromString((ROOT / "schemas/baseline.binpb").read_bytes())
    assert breaks(baseline, today) == []


def test_the_baseline_holds_all_of_today(today: FileDescriptorSet) -> None:
    baseline = FileDescriptorSet.FromString((ROOT / "schemas/baseline.binpb").read_bytes())
    missing = breaks(today, baseline)
    assert missing == [], "run tools/generate-contract"


def test_each_of_our_proto_files_is_watched(today: FileDescriptorSet) -> None:
    there = (ROOT / "schemas/proto/eigenscan/schemas").glob("*.proto")
    assert {Path(file.name).name for file in today.file} == {path.name for path in there}


def test_an_added_field_breaks_nothing(today: FileDescriptorSet) -> None:
    changed = copy.deepcopy(today)
    _message(changed, "Scan").field.add(name="new", number=2000, type=FieldDescriptorProto.TYPE_BOOL)
    assert breaks(today, changed) == []


def test_a_vanished_field_is_a_break(today: FileDescriptorSet) -> None:
    changed = copy.deepcopy(today)
    del _message(changed, "Scan").field[0]
    assert breaks(today, changed) == ["eigenscan.Scan.timestamp = 1 vanished"]


@pytest.mark.parametrize(
    ("attribute", "value"),
    [
        ("type", FieldDescriptorProto.TYPE_FLOAT),
        ("label", FieldDescriptorProto.LABEL_REPEATED),
        ("number", 77),
        ("name", "other"),
    ],
)
def test_a_changed_field_is_a_break(today: FileDescriptorSet, attribute: str, value: object) -> None:
    changed = copy.deepcopy(today)
    field = next(one for one in _message(changed, "Scan").field if one.name == "range_max")
    setattr(field, attribute, value)
    found = breaks(today, changed)
    assert len(found) == 1
    assert found[0].startswith("eigenscan.Scan.range_max = 7 ")


def test_optional_that_is_gone_is_a_break(today: FileDescriptorSet) -> None:
    changed = copy.deepcopy(today)
    fields = _message(changed, "Track").field
    field = next(one for one in fields if one.proto3_optional)
    field.ClearField("proto3_optional")
    field.ClearField("oneof_index")
    (line,) = breaks(today, changed)
    assert line.startswith(f"eigenscan.Track.{field.name} = {field.number} is now ")


def test_a_vanished_message_or_enum_value_is_a_break(today: FileDescriptorSet) -> None:
    changed = copy.deepcopy(today)
    for file in changed.file:
        for index, message in enumerate(file.message_type):
            if message.name == "Tracks":
                del file.message_type[index]
        for enum in file.enum_type:
            if enum.name == "State":
                enum.value[2].number = 9
    found = breaks(today, changed)
    assert "eigenscan.State.STATE_AMBIGUOUS = 2 vanished" in found
    assert any(line.startswith("eigenscan.Tracks.") for line in found)


def test_a_nested_message_is_compared_too(today: FileDescriptorSet) -> None:
    changed = copy.deepcopy(today)
    _message(changed, "ModelSet").nested_type[0].field[1].name = "hash"
    assert breaks(today, changed) == ["eigenscan.ModelSet.Entry.version = 2 is now hash"]


def test_the_command_refuses_a_break(tmp_path: Path, today: FileDescriptorSet) -> None:
    earlier = copy.deepcopy(today)
    _message(earlier, "Scan").field.add(
        name="gone", number=99, type=FieldDescriptorProto.TYPE_BOOL, label=FieldDescriptorProto.LABEL_OPTIONAL
    )
    baseline = tmp_path / "baseline.binpb"
    baseline.write_bytes(earlier.SerializeToString())
    ran = subprocess.run(
        [sys.executable, "-m", "eigenscan.schemas.evolution", str(baseline)],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert ran.returncode == 1
    assert "eigenscan.Scan.gone = 99 vanished" in ran.stderr
    assert baseline.read_bytes() == earlier.SerializeToString()
