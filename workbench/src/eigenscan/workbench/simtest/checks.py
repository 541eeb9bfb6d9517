"""What must hold at a site whatever befalls it, looked at after each message and at the end."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.node import WHOLE_SITE_SLACK
from eigenscan.runtime.recording import RecordingError, read
from eigenscan.runtime.recording.files import is_only_begun
from eigenscan.runtime.recording.writing import CHUNK_BYTES
from eigenscan.runtime.work import SILENT_S
from eigenscan.schemas.channels import CHANNELS, HEALTH, HYPOTHESES, POSE, SCAN_RAW, TRACKS
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tick import TICK
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Tracks
from eigenscan.schemas.wire import encode
from eigenscan.schemas.words import status_word
from eigenscan.tracker.planar import wrap
from eigenscan.workbench.simtest.disk import WRITTEN_BACK_S
from eigenscan.workbench.simtest.process import Process
from eigenscan.workbench.simtest.session import Sample, Session, channel_of
from eigenscan.workbench.simtest.site import BUDGET_MB, SITE, Life, Site

SETTLE_S = 45.0
"""After the last fault, until when all must work again, with a scan a second: 20 s until a deaf service ends,
1 s for its restart, and what a lost robot needs."""
UNIQUE_S = 20.0
"""For which a robot must have been where nothing looks the same, to be localized."""
SLIPPED_S = 5.0
"""After wheels slipped, until a claim must be right again: no level holds where odometry is not as stated."""
LATE_S = 2.0
"""After SILENT_S, until health reports it."""
INPUTS = {"tracker": HYPOTHESES, "scan-ingest": SCAN_RAW}
FAR_M, FAR_RAD = 1.0, math.radians(20.0)
"""A claim without a protection level that is farther off is wrong."""
LATCHED = {channel.name for channel in CHANNELS if channel.qos.latched}
RECEIVED_LATCHED, RECEIVED_TICK = tuple(f"heard_{name}" for name in sorted(LATCHED)), f"heard_{TICK.name}"
SHALLOW = min(channel.qos.depth for channel in CHANNELS if channel.qos.depth)
"""Messages that any queue may hold."""
KILL_S = 1.5
"""Of traffic, that a kill may cost: the recorder's flush_s and a second."""


@dataclass(frozen=True)
class Broken:
    """An invariant that did not hold."""

    at: float
    rule: str
    detail: str


class Judge:
    """Watches a site."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.settle_s = SETTLE_S / min(1.0, site.plan.scan_hz)
        self.broken: list[Broken] = []
        self.counts: Counter[str] = Counter()
        self._arrived: dict[Process, dict[str, int]] = {}
        self._input_at: dict[Session, float] = {}
        self._health: dict[Process, tuple[float, Health]] = {}
        self._claimed: dict[str, float] = {}
        self._slipped: dict[str, float] = {}
        self._posed: dict[str, float] = {}
        self._unique_since: dict[str, float] = {}
        self._inputs: dict[Session, int] = {}
        self._queues: dict[Session, tuple[str, Inbox, int]] = {}
        """Of a service: its input's name, its inbox, and the factor on the depth of its queues."""
        self._latched: dict[str, tuple[Session, bytes]] = {}
        site.network.observer = self.see
        site.on_condition = self.note_condition
        wake = site.network.arrived

        def arrived(session: Session, is_patient: bool) -> None:
            self._bound(session)
            wake(session, is_patient)

        site.network.arrived = arrived

    def fail(self, rule: str, detail: str) -> None:
        """Something that must hold does not."""
        self.broken.append(Broken(self.site.agenda.now, rule, detail))

    def note_condition(self, process: Process) -> None:
        """A service takes stock: what had arrived at that moment."""
        assert process.session is not None
        self._arrived[process] = dict(process.session.arrived)
        queue = self._queues.get(process.session)
        if queue and any(_is_of(queue[0], key) for key in queue[1].waiting):
            # a slow service has input while some waits
            self._input_at[process.session] = self.site.agenda.now

    def see(self, session: Session, sample: Sample) -> None:
        """Something is published."""
        process, found = session.owner, channel_of(sample.key_expr)
        if process is None or found is None:
            return
        channel, address = found
        if channel.qos.latched:
            self._latched[sample.key_expr] = session, sample.payload
        if channel is TRACKS:
            self._sums_to_one(address["robot"], Tracks.FromString(sample.payload))
        elif channel is POSE:
            self._claim(address["robot"], PoseEstimate.FromString(sample.payload))
        elif channel is HEALTH:
            self._is_true(process, Health.FromString(sample.payload))

    def _sums_to_one(self, robot: str, tracks: Tracks) -> None:
        self.counts["tracks"] += 1
        values = [track.probability for track in tracks.tracks] + [tracks.none_probability]
        if not all(0.0 <= value <= 1.0 + 1e-9 for value in values) or abs(sum(values) - 1.0) > 1e-6:
            self.fail("probabilities", f"{robot}: probabilities of the tracks sum to {sum(values)}")

    def _claim(self, robot: str, pose: PoseEstimate) -> None:
        self.counts["poses"] += 1
        now = self.site.agenda.now
        self._posed[robot] = now
        truth = self.site.robots[robot].truth.get(nanoseconds(pose.timestamp))
        if truth is None:  # a stranger's list
            return
        if not self.site.robots[robot].is_unique(truth):
            self._unique_since.pop(robot, None)
        else:
            self._unique_since.setdefault(robot, now)
        if not 0.0 <= pose.confidence <= 1.0:
            self.fail("probabilities", f"{robot}: a confidence of {pose.confidence}")
        if self.site.robots[robot].slips:
            self._slipped[robot] = now
        if pose.state != STATE_LOCALIZED:
            return
        self.counts["claims"] += 1
        self._claimed[robot] = now
        if now - self._slipped.get(robot, -math.inf) <= SLIPPED_S / min(1.0, self.site.plan.scan_hz):
            return
        off = math.hypot(pose.pose.x - truth[0], pose.pose.y - truth[1])
        turned = abs(wrap(pose.pose.theta - truth[2]))
        far, turn = FAR_M, FAR_RAD
        if pose.HasField("protection_radius"):
            far, turn = pose.protection_radius, pose.protection_angle
        if not (off <= far and turned <= turn):  # a NaN is no right pose either
            self.fail(
                "claim",
                f"{robot}: claims a pose {off:.2f} m and {math.degrees(turned):.0f} deg off, with a "
                f"protection level of {far:.2f} m and {math.degrees(turn):.0f} deg",
            )

    def _is_true(self, process: Process, health: Health) -> None:
        self.counts["health"] += 1
        now = self.site.agenda.now
        before = self._health.get(process, (0.0, Health()))[1]
        if (before.status, before.detail) != (health.status, health.detail):
            name = status_word(health.status).upper()
            self.site.note(f"{process.name}: {name} {health.detail}".rstrip())
        self._health[process] = now, health
        if health.status == Health.STATUS_DEGRADED and not health.detail:
            self.fail("health", f"{process.name}: DEGRADED without a reason")
        for fault in ("core_failed", "finish_failed"):
            if health.counters[fault]:
                self.fail("crash", f"{process.name}: {fault}, see the log")
        self._counts_all(process, health)
        self._reports_silence(process, health)

    def _counts_all(self, process: Process, health: Health) -> None:
        """Whatever arrived was handled, was dropped, or waits."""
        arrived = self._arrived.get(process)
        if arrived is None:
            return
        counters = health.counters
        reported = counters["undecodable"] + counters["waiting"]
        reported += sum(
            count
            for name, count in counters.items()
            if name.startswith(("heard_", "dropped_")) and name != RECEIVED_TICK
        )
        latched = sum(count for name, count in arrived.items() if name in LATCHED or name == "unanswered")
        missing = sum(arrived.values()) - reported
        kept = sum(counters[name] for name in RECEIVED_LATCHED)
        if (
            not -kept - counters["waiting"] <= missing <= latched
        ):  # of latched ones not all are news, and some are read from disk
            self.fail("health", f"{process.name}: {missing} messages arrived that no counter has")

    def _reports_silence(self, process: Process, health: Health) -> None:
        """A service that gets nothing reports it."""
        wanted = INPUTS.get(health.service)
        session = process.session
        if wanted is None or session is None:
            return
        now = self.site.agenda.now
        silent = now - self._input_at.setdefault(session, now)  # one that never got any, since it speaks
        if silent > SILENT_S + LATE_S and health.status == Health.STATUS_OK:
            self.fail("health", f"{process.name}: OK, without {wanted.name} for {silent:.0f} s")

    def _bound(self, session: Session) -> None:
        """Something was handed to a session: what waits stays within the queues' depth."""
        process = session.owner
        if process is None or process.node is None:
            return
        queue = self._queues.get(session)
        if queue is None:
            service = process.node.service
            wanted = INPUTS.get(service.name)
            slack = WHOLE_SITE_SLACK if service.whole_site else 1
            queue = self._queues[session] = (wanted.name if wanted else "", process.node.inbox, slack)
        name, inbox, slack = queue
        if name and session.arrived[name] != self._inputs.get(session, 0):
            self._inputs[session] = session.arrived[name]
            self._input_at[session] = self.site.agenda.now
        if len(inbox) > SHALLOW:
            for key, waiting in inbox.waiting.items():
                found = channel_of(key)
                depth = found[0].qos.depth if found else 0
                if depth and waiting > slack * depth:
                    self.fail(
                        "memory", f"{process.name}: {waiting} messages of {key} wait, of {depth} at most"
                    )

    def finish(self) -> None:
        """At the end, once all had the time to recover."""
        for rule, detail in self._complaints():
            self.fail(rule, detail)

    def all_is_well(self, since: float) -> bool:
        """Whether all works, nothing is about to fail, and each robot claims a pose or cannot know it."""
        network = self.site.network
        return (
            not any(session.is_silent for session in network.sessions)
            and all(link.stands for link in network.links.values())
            and all(
                robot not in self._unique_since or self._claimed.get(robot, 0.0) > since
                for robot in self.site.robots
            )
            and not any(self._complaints())
        )

    def _complaints(self) -> Iterator[tuple[str, str]]:
        """What does not work now: the rule and the words."""
        now = self.site.agenda.now
        for process in self.site.processes:
            if not process.is_wanted:
                continue
            at, health = self._health.get(process, (0.0, None))
            if not process.is_up or health is None or now - at > 3.0:
                yield "recovery", f"{process.name}: is not back {self.settle_s:.0f} s after the last fault"
            elif health.status != Health.STATUS_OK:
                name = status_word(health.status).upper()
                yield "recovery", f"{process.name}: {name}: {health.detail}"
            else:
                yield from self._old_latched(process)
        for robot in self.site.robots:
            if now - self._posed.get(robot, 0.0) > 3.0 / self.site.plan.scan_hz + 1.0:
                yield "recovery", f"{robot}: no pose {self.settle_s:.0f} s after the last fault"
            elif (
                now - self._unique_since.get(robot, now) > UNIQUE_S
                and now - self._claimed.get(robot, 0.0) > 3.0 / self.site.plan.scan_hz
            ):
                yield "recovery", f"{robot}: is not localized {self.settle_s:.0f} s after the last fault"

    def _old_latched(self, process: Process) -> Iterator[tuple[str, str]]:
        """Every service has the newest map and models that it receives and that somebody still holds."""
        observer = self.site.observers[process]
        for key, (publisher, payload) in self._latched.items():
            found = channel_of(key)
            wanted = found and publisher.is_open and found[0] in observer.inputs
            if found and wanted and observer.latched.get(key) != payload:
                yield "latched", f"{process.name}: has not the newest {found[0].name}"

    def recordings(self) -> None:
        """After all has ended: what was recorded can be read, and is complete but for the stated window."""
        for process, lives in self.site.lives.items():
            if any(life.handled for life in lives):
                self._recording(process, lives)

    def _recording(self, process: Process, lives: list[Life]) -> None:
        found: Counter[tuple[str, int]] = Counter()
        for name in sorted(process.disk.files):
            path = process.disk.path(name)
            if is_only_begun(path):  # it was killed there
                continue
            try:
                for record in read(path):
                    found[record.envelope.key, hash(encode(record.envelope.message))] += 1
                    self.counts["recorded"] += 1
            except RecordingError as error:
                self.fail("recording", f"{process.name}: {error}")
        if process.machine != SITE:
            size = sum(len(inode.data) for inode in process.disk.files.values())
            if size > 1e6 * BUDGET_MB + CHUNK_BYTES:
                self.fail("recording", f"{process.name}: {size} bytes, with a budget of {BUDGET_MB} MB")
            self._keeps_newest(process, lives[-1], found)
            return  # old files are deleted
        for life in lives:
            assert life.ended is not None
            wanted = [(at, (key, own)) for at, channel, key, own in life.handled if not channel.qos.latched]
            missing = [at for at, message in wanted if not _take(found, message)]
            lost = life.counters.get("mcap_lost", 0)
            # what a recorder that was stopped had written may still be lost with the power
            off = [at for at in self.site.machines[process.machine].lost_power if at >= life.ended]
            safe = min([_kept_until(life), *(at - WRITTEN_BACK_S for at in off)])
            missing = [at for at in missing if at <= safe]
            unexplained = len(missing) - lost
            if unexplained > 0:
                self.fail(
                    "recording",
                    f"{process.name}: {len(missing)} messages are missing, the first of second "
                    f"{missing[0]:.2f}; it was {life.how} at second {life.ended:.2f}, with {lost} lost",
                )

    def _keeps_newest(self, process: Process, life: Life, found: Counter[tuple[str, int]]) -> None:
        """Of a recorder with a budget: the oldest files are deleted, whatever the clock says."""
        wanted = [(at, (key, own)) for at, channel, key, own in life.handled if not channel.qos.latched]
        held = [(_take(found, message), at) for at, message in reversed(wanted)]
        oldest = min((at for is_held, at in held if is_held), default=math.inf)
        until = _kept_until(life)
        gone = [
            at for is_held, at in held if not is_held and at <= until and (at > oldest or oldest == math.inf)
        ]
        unexplained = len(gone) - life.counters.get("mcap_lost", 0)
        if unexplained > 0:
            self.fail(
                "recording",
                f"{process.name}: {len(gone)} messages are missing, the last of second {gone[0]:.2f}, though "
                f"older ones are kept from second {oldest:.2f} on",
            )


def _is_of(name: str, key: str) -> bool:
    """Whether a key is one of this channel."""
    found = channel_of(key)
    return found is not None and found[0].name == name


def _kept_until(life: Life) -> float:
    """Second until which a recorder must have kept what it handled: the last before a kill may be lost."""
    assert life.ended is not None
    return math.inf if life.how in ("stopped", "deaf") else life.ended - KILL_S


def _take(found: Counter[tuple[str, int]], message: tuple[str, int]) -> bool:
    if found[message] > 0:
        found[message] -= 1
        return True
    return False
