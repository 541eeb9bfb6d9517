"""Faults of sensors and of set-ups, put into a stretch of a log: what benchmarks/integrity.py tries."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import compose, from_pose3, inverse, to_pose3
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW, Channel
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.evaluation.kidnap import splice
from eigenscan.workbench.evaluation.log import Log
from eigenscan.workbench.evaluation.windows import Window
from eigenscan.workbench.playback.cast import shifted
from elsewhere import Elsewhere
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray

Array = NDArray[np.float64]

NS = 1_000_000_000
NOISE_M = 0.01
"""Sigma of a range's noise: a lidar's of today."""
ROOM_M = (6.0, 4.0)
"""Sides of the invented room."""
ROOM_TURN = 0.5
"""rad/s, how fast the robot turns in it."""
RUNS_AWAY = 1.0
"""m/s that odometry adds where it runs away."""
SLIPS_EVERY_S, SLIPS_FROM_S, SLIPS_S = 20.0, 10.0, 3.0
"""s: how often wheels slip, from when on, and for how long."""
JUMP_EVERY_S = 5.0
JUMP = np.array([3.0, -2.0, 1.0])
"""m, m, rad that odometry's frame jumps by."""


@dataclass(frozen=True)
class Stretch:
    """What the pipeline receives, and how it is judged.

    `other`: messages of another stretch of the log, as long; `elsewhere` gives those of another building, or
    none. `truth_at`: of a scan's stamp, ns, the reference's, where these differ; None: no pose is right.
    """

    received: list[Envelope]
    other: list[Envelope]
    random: np.random.Generator
    truth_at: dict[int, int | None] = field(default_factory=dict)
    elsewhere: Callable[[], list[Envelope]] = list

    def publishing(
        self, received: Sequence[Envelope], truth_at: dict[int, int | None] | None = None
    ) -> "Stretch":
        """The same, receiving something else, in the order of its stamps."""
        return Stretch(sorted(received, key=lambda e: e.stamp), self.other, self.random, truth_at or {})


Fault = Callable[[Stretch], Stretch]


def scans_changed(change: Callable[[RawScan, int, Stretch], None]) -> Fault:
    """Each raw scan after `change` of (message, its number, the stretch)."""

    def fault(stretch: Stretch) -> Stretch:
        received, count = list[Envelope](), 0
        for original in stretch.received:
            envelope = original
            if envelope.channel is SCAN_RAW:
                message = RawScan()
                message.CopyFrom(envelope.open(RawScan))
                change(message, count, stretch)
                count += 1
                envelope = Envelope(SCAN_RAW, envelope.address, message)
            received.append(envelope)
        return stretch.publishing(received)

    return fault


def odometry_changed(change: Callable[[Array, float, Stretch], Array]) -> Fault:
    """Each odometry pose after `change` of (pose, seconds since the first, the stretch)."""

    def fault(stretch: Stretch) -> Stretch:
        received, first = list[Envelope](), min(e.stamp for e in stretch.received)
        for original in stretch.received:
            envelope = original
            if envelope.channel is ODOMETRY:
                message = Odometry()
                message.CopyFrom(envelope.open(Odometry))
                pose = change(from_pose3(message.pose), (envelope.stamp - first) / NS, stretch)
                message.pose.CopyFrom(to_pose3(pose))
                envelope = Envelope(ODOMETRY, envelope.address, message)
            received.append(envelope)
        return stretch.publishing(received)

    return fault


def put(message: RawScan, ranges: Array) -> None:
    del message.ranges[:]
    message.ranges.extend(ranges.tolist())


def covered(metres: float, noise: float = 0.0) -> Fault:
    def change(message: RawScan, _: int, stretch: Stretch) -> None:
        put(message, metres + noise * stretch.random.standard_normal(len(message.ranges)))

    return scans_changed(change)


def frozen(noise: float, after_s: float = 0.0) -> Fault:
    """One scan of each lidar again and again, from some time on."""

    def fault(stretch: Stretch) -> Stretch:
        first, held = min(e.stamp for e in stretch.received), dict[str, Array]()
        received = list[Envelope]()
        for original in stretch.received:
            envelope = original
            if envelope.channel is SCAN_RAW and envelope.stamp - first >= after_s * NS:
                message = RawScan()
                message.CopyFrom(envelope.open(RawScan))
                kept = held.setdefault(envelope.address["lidar"], np.asarray(message.ranges))
                put(message, kept + noise * stretch.random.standard_normal(len(kept)))
                envelope = Envelope(SCAN_RAW, envelope.address, message)
            received.append(envelope)
        return stretch.publishing(received)

    return fault


def stamped_late(by: Callable[[int], int], channel: Channel) -> Fault:
    """Messages of a channel are stamped late by what `by` gives of the time since the first one, ns."""

    def fault(stretch: Stretch) -> Stretch:
        stamps = [e.stamp for e in stretch.received]
        first, last = min(stamps), max(stamps)
        moved = [shifted(e, by(e.stamp - first)) if e.channel is channel else e for e in stretch.received]
        return stretch.publishing([e for e in moved if first <= e.stamp <= last])

    return fault


def late(seconds: float, channel: Channel = SCAN_RAW) -> Fault:
    """Each scan, or odometry, is stamped so much after it was taken; before it, if that is negative."""
    by = round(seconds * NS)
    return stamped_late(lambda _: by, channel)


def falls_behind(seconds: float, after_s: float) -> Fault:
    """A queue fills up: scans come ever later, by 1 s each second, until they are so late."""
    after, most = round(after_s * NS), round(seconds * NS)
    return stamped_late(lambda passed: min(max(passed - after, 0), most), SCAN_RAW)


def mirror(message: RawScan, _: int, __: Stretch) -> None:
    message.angle_min = -(message.angle_min + (len(message.ranges) - 1) * message.angle_increment)
    put(message, np.asarray(message.ranges)[::-1])


def mount_off(degrees: float) -> Fault:
    def change(message: RawScan, _: int, __: Stretch) -> None:
        message.mount.theta += np.radians(degrees)

    return scans_changed(change)


def knocked(degrees: float, after_s: float) -> Fault:
    """Someone knocks the lidar: from some time on it looks so much farther left than is stated."""

    def fault(stretch: Stretch) -> Stretch:
        begins = min(e.stamp for e in stretch.received) + round(after_s * NS)

        def change(message: RawScan, _: int, __: Stretch) -> None:
            if nanoseconds(message.timestamp) < begins:
                return
            beams, ranges = round(np.radians(degrees) / message.angle_increment), np.asarray(message.ranges)
            turned = np.roll(ranges, -beams)
            if len(ranges) * message.angle_increment < 2.0 * np.pi - 0.05:
                turned[len(ranges) - beams :] = np.nan  # what it now sees there was not seen before
            put(message, turned)

        return scans_changed(change)(stretch)

    return fault


def mount_away(metres: float) -> Fault:
    def change(message: RawScan, _: int, __: Stretch) -> None:
        message.mount.x += metres

    return scans_changed(change)


def mount_turns(degrees: float) -> Fault:
    """A screw is loose: the lidar turns by so much, degrees/s."""

    def fault(stretch: Stretch) -> Stretch:
        begins = min(e.stamp for e in stretch.received)

        def change(message: RawScan, _: int, __: Stretch) -> None:
            message.mount.theta += np.radians(degrees) * (nanoseconds(message.timestamp) - begins) / NS

        return scans_changed(change)(stretch)

    return fault


def person_ahead(metres: float, degrees: float) -> Fault:
    """Someone walks before the lidar, always as far away, and hides so many degrees of the room."""

    def change(message: RawScan, _: int, stretch: Stretch) -> None:
        angles = message.angle_min + message.angle_increment * np.arange(len(message.ranges))
        hidden = np.abs(wrap(angles)) < np.radians(degrees) / 2.0
        seen = np.array(message.ranges)
        seen[hidden] = metres + NOISE_M * stretch.random.standard_normal(hidden.sum())
        put(message, seen)

    return scans_changed(change)


def too_short(share: float) -> Fault:
    """So many of the beams end somewhere before the wall: rain, dust, a crowd."""

    def change(message: RawScan, _: int, stretch: Stretch) -> None:
        seen = np.array(message.ranges)
        short = stretch.random.random(len(seen)) < share
        seen[short] = np.maximum(0.2, seen[short] * stretch.random.random(short.sum()))
        put(message, seen)

    return scans_changed(change)


def ranges_changed(change: Callable[[Array], Array]) -> Fault:
    def fault(message: RawScan, _: int, __: Stretch) -> None:
        put(message, change(np.asarray(message.ranges)))

    return scans_changed(fault)


def beams_apart(times: float) -> Fault:
    """The beams are so many times as far apart as they are."""

    def change(message: RawScan, _: int, __: Stretch) -> None:
        message.angle_min *= times
        message.angle_increment *= times

    return scans_changed(change)


def repeated(times: int) -> Fault:
    """A driver publishes each scan so many times, with new stamps."""

    def fault(stretch: Stretch) -> Stretch:
        held = list[Array]()

        def change(message: RawScan, number: int, _: Stretch) -> None:
            if number % times == 0:
                held[:] = [np.array(message.ranges)]
            put(message, held[0])

        return scans_changed(change)(stretch)

    return fault


def half_of_the_one_before(stretch: Stretch) -> Stretch:
    """A driver publishes between two revolutions: the first half of each scan is the one before's."""
    before = list[Array]()

    def change(message: RawScan, _: int, __: Stretch) -> None:
        seen = np.array(message.ranges)
        half = len(seen) // 2
        if before and len(before[0]) == len(seen):
            put(message, np.append(before[0][:half], seen[half:]))
        before[:] = [seen]

    return scans_changed(change)(stretch)


def bent(message: RawScan, _: int, stretch: Stretch) -> None:
    """A bent mount: the third of the beams in the middle meets the floor after 1.5 m."""
    seen = np.array(message.ranges)
    third = len(seen) // 3
    floor = 1.5 + 0.05 * stretch.random.standard_normal(third)
    seen[third : 2 * third] = np.minimum(seen[third : 2 * third], floor)
    put(message, seen)


def late_by_chance(most_s: float) -> Fault:
    """Each scan is stamped too late, by as much as a busy computer happens to take."""

    def fault(stretch: Stretch) -> Stretch:
        last = max(e.stamp for e in stretch.received)

        def change(message: RawScan, _: int, stretch: Stretch) -> None:
            by = round(most_s * stretch.random.random() * NS)
            message.timestamp.CopyFrom(stamp(min(nanoseconds(message.timestamp) + by, last)))

        return scans_changed(change)(stretch)

    return fault


def two_robots(stretch: Stretch) -> Stretch:
    """Both stretches at once, as long as both last: no pose is that of the one robot they are taken for."""
    shift = min(e.stamp for e in stretch.received) - min(e.stamp for e in stretch.other) + 20_000_000
    ends = max(e.stamp for e in stretch.other) + shift
    own_ends = max(e.stamp for e in stretch.received)
    truth: dict[int, int | None] = {e.stamp: None for e in stretch.received if e.stamp <= ends}
    received = list(stretch.received)
    for envelope in stretch.other:
        moved = shifted(envelope, shift)
        if envelope.channel is SCAN_RAW:
            truth[moved.stamp] = None if moved.stamp <= own_ends else envelope.stamp
        received.append(moved)
    return stretch.publishing(received, truth)


def from_elsewhere(share: float) -> Fault:
    """So many of the beams, in one sector, are those of the other stretch's scans, as they follow there."""

    def fault(stretch: Stretch) -> Stretch:
        others = dict[str, list[Array]]()
        for envelope in stretch.other:
            if envelope.channel is SCAN_RAW:
                ranges = np.asarray(envelope.open(RawScan).ranges)
                others.setdefault(envelope.address["lidar"], []).append(ranges)
        taken, received = dict[str, int](), list[Envelope]()
        for original in stretch.received:
            envelope = original
            if envelope.channel is SCAN_RAW:
                lidar = envelope.address["lidar"]
                message = RawScan()
                message.CopyFrom(envelope.open(RawScan))
                ranges = np.array(message.ranges)
                elsewhere = others.get(lidar) or [ranges]
                number = taken.get(lidar, 0)
                taken[lidar] = number + 1
                foreign = elsewhere[min(number, len(elsewhere) - 1)]
                count = min(round(share * len(ranges)), len(foreign))
                ranges[:count] = foreign[:count]
                put(message, ranges)
                envelope = Envelope(SCAN_RAW, envelope.address, message)
            received.append(envelope)
        return stretch.publishing(received)

    return fault


def carried_off(after_s: float) -> Fault:
    """Someone carries the robot into another building; what cannot be tried there goes on as it was."""

    def fault(stretch: Stretch) -> Stretch:
        if not (elsewhere := stretch.elsewhere()):
            return stretch
        ends = min(e.stamp for e in stretch.received) + round(after_s * NS)
        spliced = splice([e for e in stretch.received if e.stamp < ends], elsewhere)
        last = max(e.stamp for e in stretch.received)
        received = [e for e in spliced.received if e.stamp <= last]
        return stretch.publishing(received, {e.stamp: None for e in received if e.stamp >= spliced.jump})

    return fault


def invented_room(stretch: Stretch) -> Stretch:
    """A robot turns in a room that no map has, and its odometry reports it; no pose is right."""
    first, truth = min(e.stamp for e in stretch.received), dict[int, int | None]()
    received = list[Envelope]()
    half = np.array(ROOM_M) / 2.0
    at = np.array([0.15, -0.1]) * ROOM_M
    for envelope in stretch.received:
        turned = ROOM_TURN * (envelope.stamp - first) / NS
        if envelope.channel is ODOMETRY:
            message = Odometry()
            message.CopyFrom(envelope.open(Odometry))
            message.pose.CopyFrom(to_pose3(np.array([0.0, 0.0, (turned + np.pi) % (2 * np.pi) - np.pi])))
            received.append(Envelope(ODOMETRY, envelope.address, message))
            continue
        scan = RawScan()
        scan.CopyFrom(envelope.open(RawScan))
        mount = compose(np.array([*at, turned]), np.array([scan.mount.x, scan.mount.y, scan.mount.theta]))
        side = -1.0 if scan.upside_down else 1.0
        angles = mount[2] + side * (scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges)))
        along = np.stack([np.cos(angles), np.sin(angles)])
        with np.errstate(divide="ignore"):
            reach = ((np.sign(along).T * half - mount[:2]) / along.T).min(axis=1)
        put(scan, reach + NOISE_M * stretch.random.standard_normal(len(angles)))
        truth[envelope.stamp] = None
        received.append(Envelope(SCAN_RAW, envelope.address, scan))
    return stretch.publishing(received, truth)


def map_mirrored(stretch: Stretch) -> Stretch:
    """The robot drives in the mirror image of the map's building: as if the map were mirrored."""

    def change(message: RawScan, number: int, stretch: Stretch) -> None:
        mirror(message, number, stretch)
        message.mount.y, message.mount.theta = -message.mount.y, -message.mount.theta

    moved = odometry_changed(lambda pose, *_: pose * (1.0, -1.0, -1.0))(scans_changed(change)(stretch))
    return stretch.publishing(
        moved.received, {e.stamp: None for e in moved.received if e.channel is SCAN_RAW}
    )


def without_odometry(stretch: Stretch) -> Stretch:
    return stretch.publishing([each for each in stretch.received if each.channel is not ODOMETRY])


def odometry_frozen() -> Fault:
    held: list[Array] = []

    def change(pose: Array, seconds: float, _: Stretch) -> Array:
        if seconds == 0.0 or not held:
            held[:] = [pose]
        return held[0]

    return odometry_changed(change)


def odometry_steps(change: Callable[[Array, float, float], Array]) -> Fault:
    """Odometry that sums its steps (3,) after `change` of (step, s that it took, s since the first)."""
    state: list[tuple[Array, Array, float]] = []

    def changed(pose: Array, seconds: float, _: Stretch) -> Array:
        if seconds == 0.0 or not state:
            state[:] = [(pose, pose, seconds)]
        before, summed, since = state[0]
        summed = compose(summed, change(compose(inverse(before), pose), seconds - since, seconds))
        state[:] = [(pose, summed, seconds)]
        return summed

    return odometry_changed(changed)


def odometry_off(
    way: float = 1.0, turn: float = 1.0, degrees: float = 0.0, when: Callable[[float], bool] = lambda _: True
) -> Fault:
    """Way and turns counted so many times, and degrees/s more, `when` it holds of the s since the first.

    Wheels of another radius, or farther apart; a gyroscope with a bias.
    """

    def change(step: Array, took: float, seconds: float) -> Array:
        off: Array = step * np.array([way, way, turn]) + np.array([0.0, 0.0, np.radians(degrees) * took])
        return off if when(seconds) else step

    return odometry_steps(change)


def slips(seconds: float) -> bool:
    """Whether wheels slip so long after the first message."""
    return SLIPS_FROM_S <= seconds % SLIPS_EVERY_S < SLIPS_FROM_S + SLIPS_S


def _runs_away(pose: Array, seconds: float, _: Stretch) -> Array:
    return compose(pose, np.array([RUNS_AWAY * seconds, 0.0, 0.0]))


def _jumps(pose: Array, seconds: float, _: Stretch) -> Array:
    jumps = int(seconds / JUMP_EVERY_S)
    if jumps and seconds % JUMP_EVERY_S < 0.1:
        return np.full(3, np.nan)
    for _unused in range(jumps):
        pose = compose(JUMP, pose)
    return pose


def _reversed(pose: Array, _: float, __: Stretch) -> Array:
    # the way of the frame turned by 180 degrees, headings as they are: x ahead counts as x back
    return np.array([-pose[0], -pose[1], pose[2]])


def none(stretch: Stretch) -> Stretch:
    return stretch


FAULTS: dict[str, Fault] = {
    "none": none,
    "covered, 0.5 m": covered(0.5),
    "covered, 0.7 m": covered(0.7),
    "covered, 1 m": covered(1.0),
    "covered, 0.7 m, noise": covered(0.7, NOISE_M),
    "frozen": frozen(0.0),
    "frozen, noise": frozen(NOISE_M),
    "frozen after 10 s": frozen(0.0, 10.0),
    "frozen after 10 s, noise": frozen(NOISE_M, 10.0),
    "delayed by 5 s": late(5.0),
    "scans fall behind after 10 s": falls_behind(4.0, 10.0),
    "clock 1.5 s behind": late(-1.5),
    "mirrored": scans_changed(mirror),
    "mount off by 90 deg": mount_off(90.0),
    "mount off by 180 deg": mount_off(180.0),
    "mount off by 10 deg": mount_off(10.0),
    "mount off by 0.8 m": mount_away(0.8),
    "knocked by 15 deg after 10 s": knocked(15.0, 10.0),
    "mount turns by 1 deg/s": mount_turns(1.0),
    "a person 0.6 m ahead": person_ahead(0.6, 60.0),
    "half of the beams too short": too_short(0.5),
    "no returns beyond 3 m": ranges_changed(lambda ranges: np.where(ranges > 3.0, np.inf, ranges)),
    "ranges 10 % too short": ranges_changed(lambda ranges: 0.9 * ranges),
    "ranges 10 % too long": ranges_changed(lambda ranges: 1.1 * ranges),
    "ranges 25 % too long": ranges_changed(lambda ranges: 1.25 * ranges),
    "ranges 0.3 m too long": ranges_changed(lambda ranges: ranges + 0.3),
    "ranges 0.3 m too short": ranges_changed(lambda ranges: ranges - 0.3),
    "ranges in millimetres": ranges_changed(lambda ranges: 1000.0 * ranges),
    "beams 1.1 times as far apart": beams_apart(1.1),
    "beams 0.9 times as far apart": beams_apart(0.9),
    "each scan three times": repeated(3),
    "half of each scan from the last": half_of_the_one_before,
    "a third sees the floor": scans_changed(bent),
    "late by up to 0.4 s by chance": late_by_chance(0.4),
    "odometry 1.5 times too far": odometry_off(way=1.5),
    "turns counted 0.8 times": odometry_off(turn=0.8),
    "turns counted 1.3 times": odometry_off(turn=1.3),
    "odometry 0.3 s late": late(0.3, ODOMETRY),
    "heading drifts by 2 deg/s": odometry_off(degrees=2.0),
    "wheels slip ahead after 10 s": odometry_off(way=3.0, when=slips),
    "wheels slip aside after 10 s": odometry_off(degrees=15.0, when=slips),
    "odometry backwards": odometry_changed(_reversed),
    "two robots, one name": two_robots,
    "half of the beams from elsewhere": from_elsewhere(0.5),
    "70 % of the beams from elsewhere": from_elsewhere(0.7),
    "an invented room": invented_room,
    "the map is mirrored": map_mirrored,
    "carried off the map after 10 s": carried_off(10.0),
    "no odometry": without_odometry,
    "odometry frozen": odometry_frozen(),
    "odometry runs away": odometry_changed(_runs_away),
    "odometry jumps": odometry_changed(_jumps),
}

BEGINS_S = {name: 10.0 for name in FAULTS if "after 10 s" in name} | {"odometry jumps": JUMP_EVERY_S}
"""s from the first scan on; others are there from the start."""


def faulty(
    name: str, received: list[Envelope], log: Log, windows: Sequence[Window], number: int, others: Elsewhere
) -> Stretch:
    """What is `received` in a window of a log, with a fault."""
    other = windows[(number + len(windows) // 2) % len(windows)]
    random = np.random.default_rng(zlib.crc32(f"{name} {number}".encode()))

    def elsewhere() -> list[Envelope]:
        return others.stretch(number, len(windows), received)

    return FAULTS[name](Stretch(received, log.between(other), random, elsewhere=elsewhere))
