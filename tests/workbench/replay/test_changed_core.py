"""Components that are wrong on purpose: each is caught, at the first message that it spoils."""

import json
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import replace
from math import inf
from pathlib import Path

import pytest
from eigenscan.projector.options import ProjectorOptions
from eigenscan.schemas.channels import HYPOTHESES, POSE, SCAN, Channel
from eigenscan.schemas.envelope import Condition, Core, Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.tracker.options import TrackerOptions
from eigenscan.workbench.replay.casting import Instance
from eigenscan.workbench.replay.report import report
from eigenscan.workbench.replay.services import PROJECTOR, SCAN_INGEST, TRACKER, Service
from eigenscan.workbench.replay.survey import survey
from eigenscan.workbench.replay.trial import Outcome, Trial, run

from tests.workbench.replay.conftest import Run

SPOILT = 20
"""The message of its channel that is spoilt, and all that follow."""

Spoil = Callable[[Envelope], Iterator[Envelope]]


class Wrong:
    """A core whose words on one channel are spoilt from the SPOILT-th on."""

    def __init__(self, core: Core, channel: Channel, spoil: Spoil) -> None:
        self._core, self._channel, self._spoil = core, channel, spoil
        self.inputs, self.outputs = core.inputs, core.outputs
        self._count = 0

    def _pass(self, published: Iterable[Envelope]) -> Iterator[Envelope]:
        for envelope in published:
            self._count += envelope.channel is self._channel
            if envelope.channel is self._channel and self._count > SPOILT:
                yield from self._spoil(envelope)
            else:
                yield envelope

    def start(self) -> Iterable[Envelope]:
        return self._pass(self._core.start())

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        return self._pass(self._core.handle(received))

    def finish(self) -> Iterable[Envelope]:
        return self._pass(self._core.finish())

    def condition(self) -> Condition:
        return self._core.condition()


def mirrored(envelope: Envelope) -> Iterator[Envelope]:
    """Beams in the wrong direction."""
    scan = envelope.open(Scan)
    scan.ranges[:] = list(scan.ranges)[::-1]
    yield envelope


def degrees(envelope: Envelope) -> Iterator[Envelope]:
    """Headings in another unit."""
    for hypothesis in envelope.open(Hypotheses).hypotheses:
        hypothesis.pose.theta *= 57.29577951308232
    yield envelope


def backwards(envelope: Envelope) -> Iterator[Envelope]:
    """Least likely first."""
    message = envelope.open(Hypotheses)
    listed = list(message.hypotheses)[::-1]
    del message.hypotheses[:]
    message.hypotheses.extend(listed)
    yield envelope


def silent(_envelope: Envelope) -> Iterator[Envelope]:
    """Nothing any more."""
    return iter(())


def sure(envelope: Envelope) -> Iterator[Envelope]:
    """Never in doubt."""
    envelope.open(PoseEstimate).confidence = 1.0
    yield envelope


def replayed(recording: Path, service: Service, channel: Channel, spoil: Spoil) -> Outcome:
    make = service.make
    wrong = replace(service, make=lambda settings: Wrong(make(settings), channel, spoil))
    return run(Trial((wrong,)), survey(recording))


@pytest.mark.parametrize(
    ("service", "channel", "spoil", "path"),
    [
        (SCAN_INGEST, SCAN, mirrored, "ranges[0]"),
        (PROJECTOR, HYPOTHESES, degrees, "hypotheses[0].pose.theta"),
        (PROJECTOR, HYPOTHESES, backwards, "hypotheses[0].pose.x"),
        (TRACKER, POSE, silent, "(message)"),
        (TRACKER, POSE, sure, "confidence"),
    ],
)
def test_a_wrong_component_is_caught_where_it_begins(
    run: Run, recording: Path, service: Service, channel: Channel, spoil: Spoil, path: str
) -> None:
    outcome = replayed(recording, service, channel, spoil)
    assert outcome.comparison.problems
    first = outcome.comparison.first
    assert first is not None
    of_channel = [timed.envelope for timed in run.messages if timed.envelope.channel is channel]
    expected = of_channel[SPOILT]
    assert (first.channel, first.key) == (channel, expected.key)
    assert first.stamp == expected.stamp
    assert first.fields[0].path == path
    assert path in report(outcome)
    count = outcome.comparison.counts[channel]
    # what a local fit lists is the same backwards
    after = [(one.message, [each.message for each in spoil(deepcopy(one))]) for one in of_channel[SPOILT:]]
    harmless = sum(spoilt == [message] for message, spoilt in after)
    assert count.same == SPOILT + harmless
    assert count.different + count.missing == len(of_channel) - SPOILT - harmless


def test_a_core_that_fails_is_outlived_and_named(run: Run, recording: Path) -> None:
    def failing(_envelope: Envelope) -> Iterator[Envelope]:
        raise ArithmeticError("spoilt")

    outcome = replayed(recording, TRACKER, POSE, failing)
    published = outcome.comparison.counts[POSE]
    assert (published.same, published.missing) == (SPOILT, published.recorded - SPOILT)
    (note,) = outcome.notes
    assert f"failed on {published.missing} messages; first, ArithmeticError on site/robot/robot/" in note


def test_what_was_published_before_a_failure_counts() -> None:
    class Half:
        inputs, outputs = (SCAN,), (HYPOTHESES,)

        def handle(self, received: Envelope) -> Iterator[Envelope]:
            yield Envelope(HYPOTHESES, {**received.address, "projector": "p"}, Hypotheses())
            raise KeyError("gone")

    instance = Instance(PROJECTOR, "p", "*", "", Half(), "{}")  # type: ignore[arg-type]
    published = Loopback([instance]).receive(
        Envelope(SCAN, {"site": "s", "robot": "r", "lidar": "l"}, Scan())
    )
    assert [envelope.channel for envelope in published] == [HYPOTHESES]
    assert instance.faults == ["KeyError on s/robot/r/scan/l: 'gone'"]


def test_settings_that_are_reported_make_the_same_service(tmp_path: Path) -> None:
    settings = TrackerOptions(trust=0.6, robot="r7", metrics_port=9100, zenoh=tmp_path, log_level="debug")
    reported = json.loads(settings.answering_json())
    assert not {"metrics_port", "metrics_host", "zenoh", "log_level", "log_format"} & reported.keys()
    assert TrackerOptions.model_validate(reported) == TrackerOptions(trust=0.6, robot="r7")


def test_a_setting_without_an_end_is_reported_as_such() -> None:
    settings = ProjectorOptions(request_within=inf)
    assert ProjectorOptions.model_validate(json.loads(settings.answering_json())) == settings
