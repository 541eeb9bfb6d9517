"""A service of the first release in the simulation: its messages, and what upgrades find."""

from itertools import groupby
from pathlib import Path

import pytest
from eigenscan.eigenspace.model import FORMAT, WITHOUT_SPACE
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import HYPOTHESES, MODEL, MODEL_SET, SCAN_MOTION
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import ModelSet, RegionModel
from eigenscan.schemas.scan_pb2 import ScanMotion
from eigenscan.schemas.wire import encode
from eigenscan.workbench.simtest.faults import Fault
from eigenscan.workbench.simtest.first_release import CHANNELS, LACKED, FirstRelease
from eigenscan.workbench.simtest.network import Network
from eigenscan.workbench.simtest.session import Sample, Session
from eigenscan.workbench.simtest.trial import run
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader

DEPOT = Path(__file__).parents[1] / "replay/first_release/depot.mcap"


def test_it_lacks_what_the_recording_of_then_lacks() -> None:
    with DEPOT.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    then = {
        f"{part.package}.{message.name}": {field.name for field in message.field}
        for schema in summary.schemas.values()
        for part in FileDescriptorSet.FromString(schema.data).file
        for message in part.message_type
    }
    messages = {record.envelope.channel: record.envelope.message for record in read(DEPOT)}
    assert {channel.name for channel in messages} == CHANNELS
    today = {}
    waiting = [message.DESCRIPTOR for message in messages.values()]
    while waiting:
        kind = waiting.pop()
        if kind.full_name not in today and kind.full_name in then:
            today[kind.full_name] = set(kind.fields_by_name)
            waiting += [field.message_type for field in kind.fields if field.message_type is not None]
    lacked = {name: fields - then[name] for name, fields in today.items() if fields - then[name]}
    assert lacked == {name: set(fields) for name, fields in LACKED.items()}


def test_later_channels_are_silent_and_later_fields_gone() -> None:
    first = FirstRelease()
    address = {"site": "s", "robot": "r", "lidar": "l", "projector": "p"}
    assert first.payload(SCAN_MOTION.key(address), encode(ScanMotion(explained=0.5))) is None
    message = Hypotheses(searched_area_m2=3.0, motion=ScanMotion(explained=0.5))
    wanted = Hypotheses(searched_area_m2=3.0)
    assert first.payload(HYPOTHESES.key(address), encode(message)) == encode(wanted)


@pytest.mark.parametrize(("place", "part", "name"), [("site", 1, "mapbuilder"), ("r1", 0, "scan-ingest")])
def test_a_robot_localizes_before_and_after_an_upgrade(
    monkeypatch: pytest.MonkeyPatch, place: str, part: int, name: str
) -> None:
    formats, sets = list[int](), list[str]()
    publish = Network.publish

    def noted(network: Network, session: Session, sample: Sample, *, block: bool) -> None:
        if MODEL.parse(sample.key_expr):
            formats.append(RegionModel.FromString(sample.payload).format)
        if MODEL_SET.parse(sample.key_expr):
            sets.append(ModelSet.FromString(sample.payload).version)
        publish(network, session, sample, block=block)

    monkeypatch.setattr(Network, "publish", noted)
    outcome = run(1, 1, [Fault(12.0, "first release", place, part, 0.0, 15.0)], real=True)
    assert outcome.broken == ()
    assert outcome.counts["claims"] > 0.8 * outcome.counts["poses"] > 0
    ends = [text for at, text in outcome.notes if text == f"{name} of {place}: stopped"]
    assert len(ends) >= 2
    if name == "mapbuilder":
        assert [each for each, _ in groupby(formats)] == [FORMAT, WITHOUT_SPACE, FORMAT]
        assert sets[0] == sets[2] != sets[1]
        taken = [text for _, text in outcome.notes if text.startswith("projector of r1: OK model")]
        assert [text.rpartition(" ")[2] for text in taken[-2:]] == [sets[1][:12], sets[2][:12]]
