"""One replay from a file to a verdict, for the commands and the test suite."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from errno import EIO
from pathlib import Path

from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.whole import whole
from eigenscan.workbench.replay.casting import Changes, Instance, cast
from eigenscan.workbench.replay.comparison import Comparison, Terms
from eigenscan.workbench.replay.playing import Event, Side, play
from eigenscan.workbench.replay.reference import Reference
from eigenscan.workbench.replay.services import Service, published_by
from eigenscan.workbench.replay.survey import Survey


@dataclass(frozen=True)
class Trial:
    """A replay and its rules."""

    services: tuple[Service, ...]
    terms: Terms = field(default_factory=Terms)
    changes: Changes = field(default_factory=dict)
    models: Sequence[Envelope] = ()
    """Instead of those of the recording."""
    reference: Reference | None = None
    """Expected messages, if not the recorded ones."""
    out: Path | None = None
    """Recording to write: all inputs, and the present answers."""


@dataclass(frozen=True)
class Outcome:
    """Result of a trial."""

    survey: Survey
    instances: list[Instance]
    comparison: Comparison
    received: Counter[Channel]
    took_s: float

    @property
    def notes(self) -> list[str]:
        """Notes on the recording and this replay that a reader of the verdict needs."""
        return [*_of_the_file(self.survey), *_of_the_run(self.survey, self.instances)]


def run(trial: Trial, survey: Survey, moved: Callable[[int], None] = lambda _time: None) -> Outcome:
    """Replays and compares. Raises UsageError or RecordingError for input that cannot be replayed."""
    before = time.perf_counter()
    instances = cast(survey, trial.services, trial.changes)
    spans = trial.reference.spans if trial.reference else survey.spans
    comparison = Comparison(published_by(trial.services), spans, trial.terms)
    received = Counter[Channel]()
    events = _events(trial, survey, instances, moved)
    ran = survey.settings | {each.service.name: each.settings for each in reversed(instances)}
    for event in _written(trial.out, ran, events) if trial.out else events:
        received[event.envelope.channel] += event.side is Side.RECEIVED
        comparison.take(event)
    comparison.finish()
    return Outcome(survey, instances, comparison, received, time.perf_counter() - before)


def _events(
    trial: Trial, survey: Survey, instances: Sequence[Instance], moved: Callable[[int], None]
) -> Iterator[Event]:
    events = play(survey, trial.services, instances, trial.models, moved)
    return _beside(trial.reference, published_by(trial.services), events) if trial.reference else events


def picture_beside(recording: Path, choice: str) -> Path:
    """Path of the picture of a difference."""
    return recording.with_name(f"{recording.stem}.{choice}.rrd")


def picture(trial: Trial, outcome: Outcome, report: str, target: Path) -> bool:
    """Draws both sides around the first difference into a Rerun file, by a second replay.

    False if there is no difference. Raises OSError if `target` cannot be written.
    """
    first, survey = outcome.comparison.first, outcome.survey
    if first is None:
        return False
    from eigenscan.workbench.replay.picture import draw

    instances = cast(survey, trial.services, trial.changes)
    events = _events(trial, survey, instances, lambda _time: None)
    try:
        draw(target, events, trial.models or survey.latched.values(), first, report)
    except RuntimeError as error:  # Rerun's, of a full disk
        raise OSError(EIO, str(error), str(target)) from error
    return True


def _beside(reference: Reference, channels: Sequence[Channel], events: Iterable[Event]) -> Iterator[Event]:
    """The events with the reference in the recording's place."""
    wanted = reference.words(Side.RECORDED, channels)
    upcoming = next(wanted, None)
    for event in events:
        while upcoming and upcoming.time <= event.time:
            yield upcoming
            upcoming = next(wanted, None)
        if event.side is not Side.RECORDED:
            yield event
    if upcoming:
        yield upcoming
    yield from wanted


def _written(path: Path, settings: Mapping[str, str], events: Iterable[Event]) -> Iterator[Event]:
    """Writes what was received and answered, with each service's settings."""
    metadata = {service: {"settings": text} for service, text in settings.items()}
    with whole(path) as part, RecordingWriter(part, metadata) as writer:
        for event in events:
            if event.side is not Side.RECORDED:
                writer.write(event.envelope, event.time)
            yield event


def _of_the_file(survey: Survey) -> Iterator[str]:
    if not survey.complete:
        yield f"its writer did not close it: replayed as far as it goes, {survey.seconds:.1f} s"
    if survey.set_back:
        yield (
            f"the recorder's clock was set back at {survey.set_back / 1e9:.3f}: read in order of time, "
            "not of arrival, and answers may differ for it"
        )
    for (service, name), reported in survey.reported.items():
        lost = sum(n for what, n in reported.grown.items() if what.startswith(("mcap_lost", "dropped_")))
        if service == "recorder" and lost:
            yield (
                f"recorder {name} lost {lost} messages: they cannot be replayed, "
                "and answers may differ for it"
            )


def _of_the_run(survey: Survey, instances: Sequence[Instance]) -> Iterator[str]:
    for instance in instances:
        name = f"{instance.service.name} {instance.name}"
        for service, sign in survey.remembered.items():
            if service == instance.service.name:
                yield f"{name} ran before the recording began ({sign}): what it remembered is not in the file"
        reported = survey.reported.get((instance.service.name, instance.name))
        if reported and reported.restarts:
            yield f"{name} was started again {reported.restarts} times: the replay keeps what it forgot then"
        if reported and reported.settings_changed:
            yield f"{name} was given other settings while it was recorded: here the first hold to the end"
        for channel, count in reported.lost.items() if reported else ():
            yield f"{name} lost {count} {channel}: its inbox was full; here it receives all that is recorded"
        late = reported.counters.get("odometry_came_late", 0) if reported else 0
        if late:
            yield (
                f"{name} answered {late} scans before their odometry had come, as its patience ended: "
                "here it may be in time, and answers differ from there on"
            )
        for each in instance.inputs:
            received, held = (
                reported.counters.get(f"heard_{each.name}", 0) if reported else 0,
                survey.held(each, instance.robots),
            )
            if not each.qos.latched and received > held and survey.complete:
                yield (
                    f"{name} had received {received} {each.name}, the recording holds {held}: "
                    "what the recorder missed cannot be replayed, and answers may differ for it"
                )
        if instance.failure:
            yield instance.failure
