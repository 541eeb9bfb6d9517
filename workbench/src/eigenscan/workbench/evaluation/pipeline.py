"""Runs the real cores in one process, cold for each run, and measures their answers and cost."""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from math import inf

import numpy as np
from eigenscan.geometry.pose import covariance_from_message, from_message
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.projector.core import ProjectorCore
from eigenscan.schemas.channels import HYPOTHESES, POSE, SCAN_RAW, TRACKS, find
from eigenscan.schemas.envelope import Core, Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Tracks
from eigenscan.schemas.wire import decode, encode
from eigenscan.tracker.core import TrackerCore
from eigenscan.workbench.evaluation.chosen import PipelineSettings
from eigenscan.workbench.evaluation.explained import explained_at_claims
from eigenscan.workbench.evaluation.metrics import Stream, filled
from eigenscan.workbench.evaluation.remembering import Remembering
from eigenscan.workbench.evaluation.reported import Reported
from numpy.typing import NDArray

Packed = tuple[tuple[str, bytes], ...]


def pack(envelopes: Iterable[Envelope]) -> Packed:
    """Keys and bytes of messages, as they would travel; for another process."""
    return tuple((envelope.key, encode(envelope.message)) for envelope in envelopes)


def unpack(packed: Packed) -> Iterator[Envelope]:
    """Inverse of `pack`."""
    for key, payload in packed:
        found = find(key)
        assert found is not None
        yield Envelope(found[0], found[1], decode(found[0], payload))


@dataclass(frozen=True)
class Run:
    """Result of a run: its poses, and the process time of each scan (n,), ms.

    `explained` (k,): share of the beams that the map explains, at claims whose scans list their pose.
    `reported`: faults of a lidar, or of scans and odometry together, that health reported.
    """

    stream: Stream
    cpu_ms: NDArray[np.float64]
    explained: NDArray[np.float64]
    reported: Reported = field(default_factory=Reported)


@dataclass(frozen=True)
class Answer:
    """Result of one scan alone: base poses (n, 3), most likely first, and the process time, ms.

    `covariances` (n, 3, 3) in m^2, m rad, rad^2.
    """

    poses: NDArray[np.float64]
    covariances: NDArray[np.float64]
    log_likelihoods: NDArray[np.float64]
    cpu_ms: float


class Pipeline:
    """Scan-ingest, projector and tracker over one map's models.

    The projector keeps its tables between runs, because its answers follow from models and scan alone. The
    others start new each time.
    """

    def __init__(self, models: Sequence[Envelope], settings: PipelineSettings | None = None) -> None:
        self._models = list(models)
        self._settings = settings or PipelineSettings()
        # a pose is judged beside its tracks
        self._tracker = self._settings.tracker.model_copy(update={"tracks_hz": inf})
        self._remembering = Remembering()
        self._projector = ProjectorCore(self._settings.projector, search=self._remembering)
        self._teach(self._projector)
        condition = self._projector.condition()
        if self._models and condition.status == Health.STATUS_WAITING:
            raise ValueError(f"the projector takes no model: {condition.detail}")

    def _teach(self, core: Core) -> None:
        for model in self._models:
            if model.channel in core.inputs:
                list(core.handle(model))

    def warm_up(self, received: Iterable[Envelope]) -> None:
        """Handles a few messages before the measurement, so that all code is compiled."""
        self.run(received)
        self._remembering.forget()

    def run(self, received: Iterable[Envelope]) -> Run:
        """Receives raw scans and odometry in the order given, from a cold start."""
        ingest, tracker = ScanIngestCore(self._settings.ingest), TrackerCore(self._tracker)
        self._teach(tracker)
        self._projector.forget_robots()
        loop = Loopback([ingest, self._projector, tracker])
        answers_published, cpu_ms, scans, published = (
            list[_Published](),
            list[float](),
            list[int](),
            list[Envelope](),
        )
        spent, at_last_scan, reported = 0, 0, Reported()

        def fault() -> str:
            return _fault(ingest) or _fault(tracker).partition(": ")[2]  # without the robot's name

        loop.start()
        for envelope in received:
            before, owed = time.process_time_ns(), self._remembering.owed_ns
            answers = loop.receive(envelope)
            spent += time.process_time_ns() - before + self._remembering.owed_ns - owed
            answers_published += _poses(answers, spent)
            published += answers
            if envelope.channel == SCAN_RAW:
                reported.look(envelope.stamp, fault)
                scans.append(envelope.stamp)
                cpu_ms.append((spent - at_last_scan) / 1e6)
                at_last_scan = spent
        rest = loop.finish()
        answers_published += _poses(rest, spent)
        published += rest
        reported.count(fault())  # also where scans had ended before
        stream = _stream(
            answers_published, _nis(answers_published, published), np.sort(np.asarray(scans, dtype=np.int64))
        )
        return Run(stream, np.asarray(cpu_ms), explained_at_claims(published), reported)

    def answer(self, scan: Envelope) -> Answer:
        """Receives one raw scan: no odometry, no tracking, no prior."""
        loop = Loopback([ScanIngestCore(self._settings.ingest), self._projector])
        before, owed = time.process_time_ns(), self._remembering.owed_ns
        answers_published = [*loop.receive(scan), *loop.finish()]
        cpu_ms = (time.process_time_ns() - before + self._remembering.owed_ns - owed) / 1e6
        listed = [
            hypothesis
            for envelope in answers_published
            if envelope.channel == HYPOTHESES
            for hypothesis in envelope.open(Hypotheses).hypotheses
        ]
        return Answer(
            np.asarray([from_message(h.pose) for h in listed], dtype=np.float64).reshape(-1, 3),
            np.asarray([covariance_from_message(h.covariance) for h in listed]).reshape(-1, 3, 3),
            np.asarray([h.log_likelihood for h in listed], dtype=np.float64),
            cpu_ms,
        )


@dataclass(frozen=True)
class _Published:
    """A pose, and the process time, s, until it was published."""

    estimate: PoseEstimate
    cpu_s: float


def _fault(core: Core) -> str:
    condition = core.condition()
    return condition.detail if condition.status == Health.STATUS_DEGRADED else ""


def _poses(envelopes: Sequence[Envelope], spent: int) -> list[_Published]:
    return [_Published(e.open(PoseEstimate), spent / 1e9) for e in envelopes if e.channel == POSE]


def _nis(answers_published: Sequence[_Published], published: Sequence[Envelope]) -> NDArray[np.float64]:
    """Normalised innovation squared (n,) of each pose's track, by the tracks of its stamp; NaN: it has none.

    Two lidars may share a stamp: their tracks come in the order of their poses.
    """
    tracks: dict[int, deque[Tracks]] = defaultdict(deque)
    for envelope in published:
        if envelope.channel == TRACKS:
            tracks[envelope.stamp].append(envelope.open(Tracks))
    found = []
    for each in answers_published:
        beside = tracks[nanoseconds(each.estimate.timestamp)].popleft().tracks
        own = (t.nis for t in beside if t.id == each.estimate.track_id and t.HasField("nis"))
        found.append(next(own, np.nan))
    return np.asarray(found, dtype=np.float64)


def _stream(
    answers_published: list[_Published], nis: NDArray[np.float64], scans: NDArray[np.int64]
) -> Stream:
    estimates = [each.estimate for each in answers_published]
    stamps = np.asarray([nanoseconds(e.timestamp) for e in estimates], dtype=np.int64)
    states = np.asarray([e.state for e in estimates], dtype=np.int64)
    stream = Stream(
        stamps=stamps,
        poses=np.asarray([from_message(e.pose) for e in estimates], dtype=np.float64).reshape(-1, 3),
        states=states,
        localized=states == STATE_LOCALIZED,
        tracked=np.asarray([e.track_id != 0 for e in estimates], dtype=np.bool_),
        confidence=np.asarray([e.confidence for e in estimates], dtype=np.float64),
        covariances=np.asarray(
            [covariance_from_message(e.covariance) for e in estimates], dtype=np.float64
        ).reshape(-1, 3, 3),
        nis=nis,
        cpu_s=np.asarray([each.cpu_s for each in answers_published], dtype=np.float64),
        scans=np.searchsorted(scans, stamps),
    )
    return filled(stream, scans)
