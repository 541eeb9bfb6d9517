"""A latched sample of a publisher that is gone, which arrives after its successor's."""

import pytest
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import MODEL_SET
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.wire import decode
from eigenscan.workbench.simtest.agenda import Agenda, MachineClock
from eigenscan.workbench.simtest.network import Network

ADDRESS = {"site": "s"}


@pytest.mark.parametrize("set_back_s", [0, 3600])
def test_the_present_publisher_has_the_last_word(set_back_s: int) -> None:
    """Seed 1568: a mapbuilder was restarted with another map, and its old map took 1.9 s."""
    agenda = Agenda()
    network, clock, inbox = Network(agenda, "1"), MachineClock(agenda), Inbox()
    received: list[str] = []

    def bus() -> Bus:
        return Bus(network.open("site", clock), after=agenda.after)  # type: ignore[arg-type]

    def publish(version: str) -> Bus:
        publisher = bus()
        publisher.offer([MODEL_SET], ADDRESS)
        publisher.publish(Envelope(MODEL_SET, ADDRESS, ModelSet(version=version)))
        return publisher

    def run(until: float) -> None:
        agenda.run(until)
        while arrival := inbox.take(0.0):
            message = decode(MODEL_SET, arrival.payload)
            assert isinstance(message, ModelSet)
            received.append(message.version)

    bus().listen([MODEL_SET], ADDRESS, inbox)
    network.link("site", "site").extra_s = 1.9
    before = publish("old")
    agenda.run(0.5)
    before.close()
    clock.offset_ns -= set_back_s * 10**9
    network.link("site", "site").extra_s = 0.0
    publish("new")
    for second in range(1, 5):
        run(second)
    assert received == ["new", "old", "new"]


def test_what_takes_long_over_a_slow_link_comes_all_the_same() -> None:
    """The 590 MB of a site in docs/large-sites.md take 39 minutes at 2 Mbit/s; nothing would ask again."""
    agenda = Agenda()
    network, clock, inbox = Network(agenda, "1"), MachineClock(agenda), Inbox()
    site, robot = (Bus(network.open(name, clock), after=agenda.after) for name in ("site", "r"))  # type: ignore[arg-type]
    site.offer([MODEL_SET], ADDRESS)
    site.publish(Envelope(MODEL_SET, ADDRESS, ModelSet(version="1")))
    agenda.run(60.0)
    network.link("r", "site").extra_s = 590 * 8 / 2
    robot.listen([MODEL_SET], ADDRESS, inbox)
    agenda.run(3 * 3600.0)
    assert inbox.dropped == {}
    assert len(inbox) == 1


def test_who_was_cut_off_takes_the_answer_of_a_successor_whose_clock_was_set_back() -> None:
    agenda = Agenda()
    network, clock, inbox = Network(agenda, "1"), MachineClock(agenda), Inbox()
    site = Bus(network.open("site", clock), after=agenda.after)  # type: ignore[arg-type]
    robot = Bus(network.open("r", clock), after=agenda.after)  # type: ignore[arg-type]
    robot.listen([MODEL_SET], ADDRESS, inbox)
    site.offer([MODEL_SET], ADDRESS)
    site.publish(Envelope(MODEL_SET, ADDRESS, ModelSet(version="old")))
    agenda.run(1.0)
    link = network.link("r", "site")
    network.cut(link)
    agenda.run(60.0)
    site.close()
    clock.offset_ns -= 3600 * 10**9
    successor = Bus(network.open("site", clock), after=agenda.after)  # type: ignore[arg-type]
    successor.offer([MODEL_SET], ADDRESS)
    successor.publish(Envelope(MODEL_SET, ADDRESS, ModelSet(version="new")))
    network.mend(link)
    agenda.run(120.0)
    received = []
    while arrival := inbox.take(0.0):
        message = decode(MODEL_SET, arrival.payload)
        assert isinstance(message, ModelSet)
        received.append(message.version)
    assert received == ["old", "new"]


def test_a_successor_is_asked_again_once_the_former_publisher_is_known_to_be_gone() -> None:
    """Power was lost, so nobody ends the former one's token: a link takes ten seconds to be given up."""
    agenda = Agenda()
    network, clock, inbox = Network(agenda, "1"), MachineClock(agenda), Inbox()
    former, robot = (Bus(network.open(name, clock), after=agenda.after) for name in ("a", "r"))  # type: ignore[arg-type]
    robot.listen([MODEL_SET], ADDRESS, inbox)
    former.offer([MODEL_SET], ADDRESS)
    former.publish(Envelope(MODEL_SET, ADDRESS, ModelSet(version="old")))
    network.cut(network.link("r", "b"))
    agenda.run(60.0)
    clock.offset_ns -= 3600 * 10**9
    successor = Bus(network.open("b", clock), after=agenda.after)  # type: ignore[arg-type]
    successor.offer([MODEL_SET], ADDRESS)
    successor.publish(Envelope(MODEL_SET, ADDRESS, ModelSet(version="new")))
    network.cut(network.link("a", "r"))
    network.mend(network.link("r", "b"))
    agenda.run(180.0)
    received = []
    while arrival := inbox.take(0.0):
        message = decode(MODEL_SET, arrival.payload)
        assert isinstance(message, ModelSet)
        received.append(message.version)
    assert received == ["old", "new"]
