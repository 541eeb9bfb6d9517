"""A recording against the cores of today: the same, a named first difference, or a reason why not."""

import json
import math
import traceback
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from eigenscan.cli.process_replay import process_replay
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.plan import Plan
from eigenscan.mapbuilder.regions import Division
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import build_site
from eigenscan.runtime.errors import FailedError
from eigenscan.runtime.recording import Record, read
from eigenscan.schemas.channels import (
    ADVICE,
    HEALTH,
    HYPOTHESES,
    MAP,
    MODEL,
    MODEL_SET,
    OBSTACLES,
    ODOMETRY,
    POSE,
    SCAN,
    SCAN_MOTION,
    SCAN_RAW,
    SEARCH,
    TRACKS,
    TRANSFORM,
    Channel,
)
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, SEARCH_WHOLE, Hypotheses, Search
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.wire import encode
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.replay.survey import Survey
from eigenscan.workbench.simulation.stage import Scenario, Timed
from eigenscan.workbench.simulation.world import office
from rerun.chunk import RrdReader

from tests.workbench.replay.conftest import SECONDS, Command, Run, changed, drive

TRACKER_PUBLISHES = (POSE, SEARCH, TRACKS, TRANSFORM)


def only(messages: Sequence[Timed], *channels: Channel) -> list[Timed]:
    return [timed for timed in messages if timed.envelope.channel in channels]


def without(messages: Sequence[Timed], *channels: Channel) -> list[Timed]:
    return [timed for timed in messages if timed.envelope.channel not in channels]


def at(stamp: int) -> str:
    return f"at {stamp // 10**9}.{stamp % 10**9:09d}"


def swap(messages: Sequence[Timed], old: Timed, *new: Timed) -> list[Timed]:
    place = next(n for n, timed in enumerate(messages) if timed is old)
    return [*messages[:place], *new, *messages[place + 1 :]]


def with_message(timed: Timed, **fields: object) -> Timed:
    envelope = timed.envelope
    return Timed(timed.time, replace(envelope, message=changed(envelope.message, **fields)))


@pytest.mark.parametrize(
    ("service", "published"),
    [
        ("scan-ingest", (SCAN, SCAN_MOTION)),
        ("projector", (HYPOTHESES, OBSTACLES, ADVICE)),
        ("tracker", TRACKER_PUBLISHES),
        ("pipeline", (SCAN, SCAN_MOTION, HYPOTHESES, OBSTACLES, ADVICE, *TRACKER_PUBLISHES)),
    ],
)
def test_a_run_replays_to_the_same_bits(
    run: Run, recording: Path, eigenscan: Command, service: str, published: tuple[Channel, ...]
) -> None:
    ended = eigenscan("replay", recording, "--service", service, "--compare", "--strict")
    assert ended.code == 0, ended.out + ended.err
    assert f"the same: {len(only(run.messages, *published))} messages the same to the last bit" in ended.out
    assert "settings as recorded" in ended.out


@pytest.mark.parametrize("service", ["projector", "tracker", "pipeline"])
def test_local_fits_replay_to_the_same_bits(
    run: Run, eigenscan: Command, tmp_path: Path, service: str
) -> None:
    messages = drive(run.models, Scenario(seconds=SECONDS), TrackerSettings(local_fits=True))
    listed = [one.envelope.open(Hypotheses) for one in only(messages, HYPOTHESES)]
    assert 0.1 < np.mean([one.search == SEARCH_LOCAL for one in listed]) < 1.0  # both kinds are in it
    settings = {"tracker": json.dumps({"robot": "*", "local_fits": True})}
    settings |= dict.fromkeys(("scan-ingest", "projector"), json.dumps({"robot": "*"}))
    path = run.write(tmp_path / "local.mcap", messages, settings)
    ended = eigenscan("replay", path, "--service", service, "--compare", "--strict")
    assert ended.code == 0, ended.out + ended.err
    assert "messages the same to the last bit" in ended.out


def test_another_setting_is_caught_at_the_first_message_that_it_changes(
    run: Run, recording: Path, eigenscan: Command
) -> None:
    other = drive(run.models, Scenario(seconds=SECONDS), TrackerSettings(trust=0.6))
    pairs = zip(only(run.messages, POSE, TRACKS), only(other, POSE, TRACKS), strict=True)
    first = next(a for a, b in pairs if encode(a.envelope.message) != encode(b.envelope.message))
    ended = eigenscan("replay", recording, "--service", "tracker", "--compare", "--set", "trust=0.6")
    assert ended.code == 1
    assert f"first difference: {first.envelope.channel.name} {at(first.envelope.stamp)}" in ended.out
    assert "trust = 0.6" in ended.out
    assert ended.err.count("\n") == 1


def test_one_changed_bit_is_shown_with_its_path_stamp_and_both_values(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    pose = only(run.messages, POSE)[40]
    x = pose.envelope.open(PoseEstimate).pose.x
    nudged = math.nextafter(x, math.inf)
    path = run.write(tmp_path / "a.mcap", swap(run.messages, pose, with_message(pose, pose__x=nudged)))
    command = ("replay", path, "--service", "tracker", "--compare")
    ended = eigenscan(*command)
    assert ended.code == 1
    assert "pose: 1 different, 0 missing, 0 too many" in ended.err
    _, _, shown = ended.out.partition("first difference: ")
    assert shown.startswith(f"pose {at(pose.envelope.stamp)} on site/robot/robot/pose\n")
    assert shown.splitlines()[2].split()[:3] == ["pose.x", str(nudged), str(x)]
    assert len(shown.splitlines()) == 4  # the last shows where both sides are drawn
    assert eigenscan(*command, "--tolerant").code == 0
    ignoring = eigenscan(*command, "--ignore", "pose.pose.x")
    assert ignoring.code == 0
    assert "not judged: pose.pose.x" in ignoring.out
    assert eigenscan(*command, "--ignore", "pose.pose.y").code == 1


def test_text_of_a_recording_does_not_command_the_terminal(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    """Nor does it make results that no reader of XML takes."""
    pose = only(run.messages, POSE)[40]
    messages = swap(run.messages, pose, with_message(pose, frame_id="\x1b[2Jm\x00p"))
    word = Timed(messages[0].time, health(json.dumps({"robot": "*", "instance": "t", "gone\x1b[2J": 1})))
    path = run.write(tmp_path / "a.mcap", [word, *messages])
    ended = eigenscan("replay", path, "--service", "tracker", "--compare", "--rrd", tmp_path / "a.rrd")
    assert ended.code == 1
    assert "?[2Jm?p" in ended.out
    assert "without gone?[2J, which this version does not know" in ended.out
    assert not set(ended.out + ended.err) & {"\x1b", "\x00"}


def test_both_sides_of_a_difference_are_drawn_on_the_map(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    pose = only(run.messages, POSE)[40]
    x = pose.envelope.open(PoseEstimate).pose.x
    path = run.write(tmp_path / "a.mcap", swap(run.messages, pose, with_message(pose, pose__x=x + 2.0)))
    ended = eigenscan("replay", path, "--service", "tracker", "--compare")
    picture = tmp_path / "a.tracker.rrd"
    assert ended.code == 1
    assert ended.out.endswith(f"both sides: {picture}\n")
    chunks = [chunk for chunk in RrdReader(str(picture)).stream() if not chunk.is_static]
    drawn = {chunk.entity_path for chunk in chunks}
    for side in ("recorded", "replayed"):
        assert {f"/world/robot/{side}/pose", f"/world/robot/{side}/tracks"} <= drawn
    apart: dict[int, float] = {}
    for chunk in chunks:
        if chunk.entity_path == "/apart/robot":
            batch = chunk.to_record_batch()
            values = batch.column("Scalars:scalars").to_pylist()
            stamps = [time.value for time in batch.column("time")]
            apart |= {stamp: value for stamp, (value,) in zip(stamps, values, strict=True)}
    assert apart.pop(pose.envelope.stamp) == pytest.approx(2.0)
    assert apart
    assert set(apart.values()) == {0.0}


def test_a_robot_with_another_clock_does_not_end_the_picture(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    """Nor does the list of another projector replace the first one's."""
    listed = only(run.messages, HYPOTHESES)[4]
    log_likelihood = listed.envelope.open(Hypotheses).hypotheses[0].log_likelihood
    other = with_message(listed)
    other.envelope.open(Hypotheses).hypotheses[0].log_likelihood = log_likelihood - 1.0
    aliases = [
        Timed(timed.time, replace(timed.envelope, address={**timed.envelope.address, "projector": "second"}))
        for timed in only(run.messages, HYPOTHESES, OBSTACLES)
    ]
    ahead = [
        Timed(
            timed.time,
            Envelope(
                SCAN,
                {**timed.envelope.address, "robot": "ahead"},
                changed(timed.envelope.message, timestamp__seconds=timed.envelope.stamp // 10**9 + 60),
            ),
        )
        for timed in only(run.messages, SCAN)[:1]
    ]
    messages = [*ahead, *swap(run.messages, listed, other), *aliases]
    path = run.write(tmp_path / "a.mcap", sorted(messages, key=lambda one: one.time))
    ended = eigenscan("replay", path, "--service", "projector", "--compare")
    assert ended.code == 1, ended.out + ended.err
    chunks = RrdReader(str(tmp_path / "a.projector.rrd")).stream()
    drawn = {chunk.entity_path for chunk in chunks}
    lidar, projector = (listed.envelope.address[name] for name in ("lidar", "projector"))
    for name in (projector, "second"):
        assert f"/world/robot/recorded/hypotheses/{lidar}/{name}" in drawn


@pytest.mark.parametrize("target", ["/dev/full", "/proc/a.rrd"])
def test_a_picture_that_cannot_be_written_takes_nothing_from_the_verdict(
    run: Run, eigenscan: Command, tmp_path: Path, target: str
) -> None:
    pose = only(run.messages, POSE)[40]
    x = pose.envelope.open(PoseEstimate).pose.x
    path = run.write(tmp_path / "a.mcap", swap(run.messages, pose, with_message(pose, pose__x=x + 2.0)))
    ended = eigenscan("replay", path, "--service", "tracker", "--compare", "--rrd", target)
    assert ended.code == 1
    assert "first difference: pose" in ended.out
    assert "both sides" not in ended.out
    assert f"no picture: {target}: " in ended.err
    assert "pose: 1 different, 0 missing, 0 too many" in ended.err


def test_what_is_the_same_leaves_no_picture(recording: Path, eigenscan: Command, tmp_path: Path) -> None:
    picture = tmp_path / "b.rrd"
    ended = eigenscan("replay", recording, "--service", "tracker", "--compare", "--rrd", picture)
    assert ended.code == 0, ended.err
    assert not picture.exists()


def test_tolerance_has_an_end(run: Run, eigenscan: Command, tmp_path: Path) -> None:
    pose = only(run.messages, POSE)[40]
    x = pose.envelope.open(PoseEstimate).pose.x
    path = run.write(tmp_path / "a.mcap", swap(run.messages, pose, with_message(pose, pose__x=x + 1e-3)))
    assert eigenscan("replay", path, "--service", "tracker", "--compare", "--tolerant").code == 1


@pytest.mark.parametrize(
    ("change", "counted"),
    [
        ("removed", "pose: 0 different, 0 missing, 1 too many"),
        ("doubled", "pose: 0 different, 1 missing, 0 too many"),
        ("swapped", "pose: 1 different, 0 missing, 0 too many"),
    ],
)
def test_counts_and_order_are_compared(
    run: Run, eigenscan: Command, tmp_path: Path, change: str, counted: str
) -> None:
    poses = only(run.messages, POSE)
    pose, following = poses[30], poses[31]
    if change == "removed":
        messages = swap(run.messages, pose)
    elif change == "doubled":
        messages = swap(run.messages, pose, pose, pose)
    else:
        messages = swap(run.messages, pose, Timed(pose.time, following.envelope))
        messages = swap(messages, following, Timed(following.time, pose.envelope))
    ended = eigenscan("replay", run.write(tmp_path / "a.mcap", messages), "--service", "tracker", "--compare")
    assert ended.code == 1
    assert counted in ended.err
    # the place in a wrong order is that of the stamp that comes too early
    at_fault = following if change == "swapped" else pose
    assert f"first difference: pose {at(at_fault.envelope.stamp)}" in ended.out


def test_hypotheses_that_arrive_later_give_the_same_poses(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    """Odometry overtakes them; only the transforms rest on that, and are not judged."""
    late = [
        Timed(timed.time + 70_000_000, timed.envelope) if timed.envelope.channel is HYPOTHESES else timed
        for timed in run.messages
    ]
    path = run.write(tmp_path / "a.mcap", late)
    differs_only_strictly(eigenscan, path, "tracker", "transform: one follows each odometry sample")


def differs_only_strictly(eigenscan: Command, path: Path, service: str, why: str) -> None:
    """`why`: the channel, and why it is not judged."""
    ended = eigenscan("replay", path, "--service", service, "--compare")
    assert ended.code == 0, ended.out
    assert f"not judged: {why}" in ended.out
    strict = eigenscan("replay", path, "--service", service, "--compare", "--strict")
    assert strict.code == 1
    assert f"first difference: {why.partition(':')[0]}" in strict.out


def test_advice_rests_on_arrival_and_is_judged_only_strictly(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    """A busy projector receives poses and tracks late or not at all, so another second's pair begins."""
    advised = only(run.messages, ADVICE)
    assert advised
    changed = [with_message(timed, evidence=-1.0) if timed is advised[0] else timed for timed in run.messages]
    path = run.write(tmp_path / "a.mcap", changed)
    differs_only_strictly(eigenscan, path, "projector", "advice: one follows each second")


def test_too_few_answers_are_no_proof(run: Run, eigenscan: Command, tmp_path: Path) -> None:
    silent = run.write(tmp_path / "silent.mcap", without(run.messages, *TRACKER_PUBLISHES))
    ended = eigenscan("replay", silent, "--service", "tracker", "--compare")
    assert ended.code == 1
    assert "only 0 messages to compare" in ended.err
    last = {id(timed) for timed in only(run.messages, POSE, TRACKS)[-12:]}
    some = [t for t in run.messages if id(t) in last or t.envelope.channel not in TRACKER_PUBLISHES]
    ended = eigenscan("replay", run.write(tmp_path / "tail.mcap", some), "--service", "tracker", "--compare")
    assert ended.code == 1
    assert f"pose: only 6 of {len(only(run.messages, POSE))} messages are in the recording" in ended.err
    # one room whose words were recorded does not vouch for another
    deaf = run.write(tmp_path / "deaf.mcap", without(run.messages, TRACKS))
    ended = eigenscan("replay", deaf, "--service", "tracker", "--compare")
    assert ended.code == 1
    assert f"tracks: only 0 of {len(only(run.messages, TRACKS))} messages are in the recording" in ended.err


def health(settings: str = "", **counters: int) -> Envelope:
    message = Health(service="tracker", instance="t", package_version="9.8.7", settings=settings)
    message.counters.update(counters)
    return Envelope(HEALTH, {"site": "site", "service": "tracker", "instance": "t"}, message)


def test_recorded_settings_are_used_and_defaults_are_published(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    other = drive(run.models, Scenario(seconds=SECONDS), TrackerSettings(trust=0.6))
    text = json.dumps({"robot": "*", "instance": "t", "trust": 0.6, "gone_since": 1})
    command = ("--service", "tracker", "--compare")
    reported = [Timed(other[0].time, health(text)), *other]
    ended = eigenscan("replay", run.write(tmp_path / "told.mcap", reported), *command)
    assert ended.code == 0, ended.out + ended.err
    assert "settings as recorded without gone_since, which this version does not know" in ended.out
    assert "recorded with version 9.8.7" in ended.out
    in_file = run.write(tmp_path / "file.mcap", other, {"tracker": json.dumps({"robot": "*", "trust": 0.6})})
    assert eigenscan("replay", in_file, *command).code == 0
    tried = tmp_path / "tried.mcap"
    ended = eigenscan("replay", in_file, *command[:2], "--set", "trust=0.4", "--out", tried)
    assert ended.code == 0, ended.err
    ended = eigenscan("replay", tried, *command)
    assert (ended.code, "settings as recorded" in ended.out) == (0, True), ended.out + ended.err
    ended = eigenscan("replay", run.write(tmp_path / "untold.mcap", other), *command)
    assert ended.code == 1
    assert "default settings, for the recording does not have them" in ended.out


@pytest.mark.parametrize(
    ("searches", "noted"), [((SEARCH_LOCAL, SEARCH_WHOLE), True), ((SEARCH_WHOLE,), False)]
)
def test_a_first_list_of_a_local_fit_shows_that_the_projector_ran_before(
    searches: tuple[Search, ...], noted: bool
) -> None:
    found = Survey(Path("a.mcap"), True, {})
    address = {"site": "s", "robot": "r", "lidar": "l", "projector": "0"}
    for number, search in enumerate(searches, 1):
        message = Hypotheses(timestamp=stamp(number), search=search)
        found.take(Record(Envelope(HYPOTHESES, address, message), number, number, 1))
    assert ("projector" in found.remembered) == noted


def test_what_a_recording_cannot_show_is_noted(run: Run, eigenscan: Command, tmp_path: Path) -> None:
    text = json.dumps({"robot": "*"})
    words = [
        health(text, heard_odometry=300, dropped_odometry=7),
        health(text, heard_odometry=4),
        health(
            text.replace("}", ', "trust": 0.5}'),
            heard_odometry=5,
            dropped_odometry=3,
            odometry_came_late=2,
        ),
    ]
    messages = [
        *(Timed(run.messages[0].time, word) for word in words),
        *run.messages[len(run.messages) // 2 :],
    ]
    ended = eigenscan("replay", run.write(tmp_path / "a.mcap", messages), "--service", "tracker", "--compare")
    assert ended.code == 1
    assert "note: tracker t ran before the recording began (its first track here is " in ended.out
    assert "note: tracker t was started again 1 times" in ended.out
    assert "note: tracker t lost 3 odometry" in ended.out
    assert "note: tracker t answered 2 scans before their odometry had come" in ended.out
    assert "note: tracker t was given other settings while it was recorded" in ended.out


def test_a_clock_that_was_set_back_is_noted(run: Run, eigenscan: Command, tmp_path: Path) -> None:
    """Indexed, the file is read in order of time."""
    half = len(run.messages) // 2
    moved = [replace(timed, time=timed.time - 3_600_000_000_000) for timed in run.messages[half:]]
    path = run.write(tmp_path / "a.mcap", [*run.messages[:half], *moved])
    ended = eigenscan("replay", path, "--service", "tracker", "--compare")
    at = max(timed.time for timed in run.messages[:half]) / 1e9
    assert f"note: the recorder's clock was set back at {at:.3f}: read in order of time" in ended.out
    assert "ran before the recording began" not in ended.out
    ended = eigenscan("replay", run.write(path), "--service", "tracker", "--compare")
    assert "set back" not in ended.out


def test_what_the_recorder_missed_is_noted(run: Run, eigenscan: Command, tmp_path: Path) -> None:
    count = len(only(run.messages, ODOMETRY))
    command = ("--service", "tracker", "--compare")
    for received, is_noted in ((count, False), (count + 1, True)):
        reported = Timed(run.messages[-1].time, health(json.dumps({"robot": "*"}), heard_odometry=received))
        file = run.write(tmp_path / f"{received}.mcap", [*run.messages, reported])
        ended = eigenscan("replay", file, *command)
        noted = f"note: tracker t had received {received} odometry, the recording holds {count}" in ended.out
        assert noted is is_noted, ended.out


def test_another_robots_messages_do_not_hide_what_the_recorder_missed(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    inputs = only(run.messages, ODOMETRY)
    count = len(inputs)
    others = [
        Timed(timed.time, replace(timed.envelope, address={**timed.envelope.address, "robot": "other"}))
        for timed in inputs
    ]
    text = json.dumps({"robot": "robot", "instance": "t"})
    reported = Timed(run.messages[-1].time, health(text, heard_odometry=count + 5))
    path = run.write(
        tmp_path / "a.mcap", sorted([*run.messages, *others, reported], key=lambda one: one.time)
    )
    ended = eigenscan("replay", path, "--service", "tracker", "--compare")
    assert f"note: tracker t had received {count + 5} odometry, the recording holds {count}" in ended.out


def test_what_the_recorder_reports_as_lost_is_noted(run: Run, eigenscan: Command, tmp_path: Path) -> None:
    """What it lost before, in an earlier file, is not."""
    times = [run.messages[0].time, run.messages[len(run.messages) // 2].time, run.messages[-1].time]
    words = [
        Timed(time, Envelope(HEALTH, {"site": "site", "service": "recorder", "instance": "rec"}, message))
        for time, lost in zip(times, (20, 20, 27), strict=True)
        for message in [Health(service="recorder", instance="rec", counters={"mcap_lost": lost})]
    ]
    for number, stated in ((2, False), (3, True)):
        messages = sorted([*run.messages, *words[:number]], key=lambda one: one.time)
        path = run.write(tmp_path / f"{number}.mcap", messages)
        ended = eigenscan("replay", path, "--service", "tracker", "--compare")
        assert ("note: recorder rec lost 7 messages: they cannot be replayed" in ended.out) is stated
        assert ("note: recorder" in ended.out) is stated


@pytest.mark.parametrize("group", ["robot", "r*t,another"])
def test_an_instance_receives_only_its_robots(
    run: Run, eigenscan: Command, tmp_path: Path, group: str
) -> None:
    text = json.dumps({"robot": group, "instance": "t"})
    foreign = [
        Timed(timed.time, replace(timed.envelope, address={**timed.envelope.address, "robot": "other"}))
        for timed in only(run.messages, ODOMETRY, HYPOTHESES)
    ]
    messages = sorted([*run.messages, *foreign], key=lambda timed: timed.time)
    path = run.write(tmp_path / "a.mcap", [Timed(messages[0].time, health(text)), *messages])
    ended = eigenscan("replay", path, "--service", "tracker", "--compare", "--strict")
    assert ended.code == 0, ended.out
    published = len(only(run.messages, *TRACKER_PUBLISHES))
    assert f"the same: {published} messages" in ended.out
    assert "outside: " not in ended.out


def test_two_projectors_are_distinguished_by_their_keys(run: Run, eigenscan: Command, tmp_path: Path) -> None:
    few = run.messages[: len(run.messages) // 4]
    alias = [
        Timed(timed.time, replace(timed.envelope, address={**timed.envelope.address, "projector": "second"}))
        for timed in only(few, HYPOTHESES, OBSTACLES, ADVICE)
    ]
    path = run.write(tmp_path / "a.mcap", sorted([*few, *alias], key=lambda timed: timed.time))
    ended = eigenscan("replay", path, "--service", "projector", "--compare", "--strict")
    assert ended.code == 0, ended.out
    assert f"the same: {2 * len(alias)} messages" in ended.out


def test_what_is_published_now_can_be_kept(
    run: Run, recording: Path, eigenscan: Command, tmp_path: Path
) -> None:
    out = tmp_path / "out.mcap"
    command = ("replay", recording, "--service", "tracker", "--out", out, "--set", "trust=0.6")
    assert eigenscan(*command).code == 0
    tracker = TrackerCore(TrackerSettings(trust=0.6))
    received = [timed.envelope for timed in run.messages if timed.envelope.channel in tracker.inputs]
    other = [one for envelope in received for one in tracker.handle(envelope)]
    kept = [encode(record.envelope.message) for record in read(out) if record.envelope.channel is POSE]
    assert kept == [encode(one.message) for one in other if one.channel is POSE]
    published = {one.channel for one in other}
    taken = {ODOMETRY, SCAN_MOTION, HYPOTHESES, MODEL_SET}
    assert {record.envelope.channel for record in read(out)} == taken | published
    assert all(
        record.publish_time == record.envelope.stamp
        for record in read(out)
        if record.envelope.channel is POSE
    )


def test_a_file_that_was_cut_is_replayed_as_far_as_it_goes(
    recording: Path, eigenscan: Command, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    whole = recording.read_bytes()
    cut.write_bytes(whole[: len(whole) * 7 // 10])
    ended = eigenscan("replay", cut, "--service", "projector", "--compare")
    assert ended.code == 0, ended.out + ended.err
    assert "note: its writer did not close it: replayed as far as it goes, " in ended.out
    assert "what the recorder missed" not in ended.out


def test_a_file_that_breaks_off_before_an_input_is_named(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    """Its recorder was blamed: `record it as well`."""
    whole = run.write(tmp_path / "a.mcap", without(run.messages, HYPOTHESES))
    (tmp_path / "cut.mcap").write_bytes(whole.read_bytes()[:-400])
    ended = eigenscan("replay", tmp_path / "cut.mcap", "--service", "tracker", "--compare")
    assert "holds no hypotheses, an input of tracker: the file breaks off after" in ended.err


def test_two_copies_in_a_folder_are_named(recording: Path, eigenscan: Command, tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).write_bytes(recording.read_bytes())
    ended = eigenscan("replay", tmp_path, "--service", "tracker", "--compare")
    assert ended.code == 2
    assert "a.mcap and b.mcap hold the same messages" in ended.err


@pytest.mark.parametrize("missing", [(MAP,), (MODEL,), (MODEL_SET,), (MAP, MODEL, MODEL_SET)])
def test_models_that_are_missing_are_named(
    run: Run, eigenscan: Command, tmp_path: Path, missing: tuple[Channel, ...]
) -> None:
    path = run.write(tmp_path / "a.mcap", without(run.messages, *missing))
    ended = eigenscan("replay", path, "--service", "projector", "--compare")
    assert ended.code == 2
    lack = {MAP: "the map", MODEL: "regions", MODEL_SET: "no model"}[missing[-1]]
    assert "projector cannot be replayed" in ended.err
    assert lack in ended.err
    assert ended.err.count("\n") == 1
    assert eigenscan("replay", path, "--service", "tracker", "--compare").code == 0
    given = eigenscan("replay", path, "--service", "projector", "--compare", "--model", run.folder)
    assert given.code == 0, given.out + given.err


@pytest.mark.parametrize(
    ("content", "stated"),
    [
        (None, "cannot be read"),
        (b"", "is no readable recording"),
        (b"not an mcap at all" * 100, "is no readable recording"),
    ],
)
def test_what_is_no_recording(eigenscan: Command, tmp_path: Path, content: bytes | None, stated: str) -> None:
    path = tmp_path / "a.mcap"
    if content is not None:
        path.write_bytes(content)
    ended = eigenscan("replay", path, "--service", "tracker", "--compare")
    assert ended.code == 2
    assert ended.err.count("\n") == 1
    assert str(path) in ended.err
    assert stated in ended.err


def test_what_a_service_needs_is_named(run: Run, eigenscan: Command, tmp_path: Path) -> None:
    path = run.write(tmp_path / "a.mcap", without(run.messages, HYPOTHESES, SCAN_RAW))
    for service, channel in (
        ("tracker", "hypotheses"),
        ("scan-ingest", "scan_raw"),
        ("pipeline", "scan_raw"),
    ):
        ended = eigenscan("replay", path, "--service", service, "--compare")
        assert ended.code == 2
        assert f"holds no {channel}, an input of " in ended.err


@pytest.mark.parametrize(
    ("options", "stated"),
    [
        (("--service", "nobody", "--compare"), "--service nobody: choose one of scan-ingest"),
        (("--compare",), "missing option '--service'"),
        (("--service", "tracker"), "give --compare, --out FILE, or both"),
        (("--service", "tracker", "--compare", "--from", 2), "no such option: --from"),
        (("--service", "tracker", "--compare", "--set", "trust"), "--set trust: give SETTING=VALUE"),
        (("--service", "tracker", "--compare", "--set", "trust=high"), "tracker: trust = 'high'"),
        (
            ("--service", "tracker", "--compare", "--set", "trrust=1"),
            "tracker: trrust = '1': unknown, did you mean trust?",
        ),
        (
            ("--service", "tracker", "--compare", "--set", "projector.published=1"),
            "projector: is not replayed",
        ),
        (("--service", "tracker", "--compare", "--ignore", "pose.nothing"), "--ignore pose.nothing: give"),
    ],
)
def test_wrong_usage(recording: Path, eigenscan: Command, options: tuple[object, ...], stated: str) -> None:
    ended = eigenscan("replay", recording, *options)
    assert ended.code == 2
    assert stated in ended.err
    assert ended.err.count("\n") == 1


def test_a_map_that_was_exchanged_in_the_night_is_exchanged_in_the_replay(
    run: Run, eigenscan: Command, tmp_path: Path
) -> None:
    """The second set has regions that the first lacks: they came at the start, and were dropped."""
    site = build_site(office().render(), Plan(spacing=0.6, division=Division(largest=15.0)))
    other = tuple(MapbuilderCore(MapbuilderSettings(), site).start())
    first, second = ({one.key for one in models} for models in (run.models, other))
    assert second - first
    messages = drive(run.models, Scenario(seconds=SECONDS), TrackerSettings(), other)
    path = run.write(
        tmp_path / "exchanged.mcap", messages, dict.fromkeys(("projector", "tracker"), '{"robot": "*"}')
    )
    used = {one.envelope.open(PoseEstimate).model_version for one in only(messages, POSE)}
    assert len(used - {""}) == 2
    for service in ("projector", "tracker"):
        ended = eigenscan("replay", path, "--service", service, "--compare", "--strict")
        assert ended.code == 0, ended.out + ended.err


def test_a_core_that_fails_is_a_failure_without_a_comparison_too(
    recording: Path, eigenscan: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It wrote a recording without an answer, and ended with 0."""

    def fail(_self: TrackerCore, _received: Envelope) -> list[Envelope]:
        raise ArithmeticError("no answer")

    monkeypatch.setattr(TrackerCore, "handle", fail)
    ended = eigenscan("replay", recording, "--service", "tracker", "--out", tmp_path / "out.mcap")
    assert ended.code == 1, ended.out
    assert "tracker 0 failed on" in ended.err
    assert "ArithmeticError" in ended.err
    ended = eigenscan("replay", recording, "--service", "tracker", "--compare")
    assert ended.code == 1, ended.out
    assert "missing, 0 too many; tracker 0 failed on" in ended.err.splitlines()[-1]
    assert "no answer" in ended.err.splitlines()[-1]
    with pytest.raises(FailedError) as raised:
        process_replay(
            recording,
            "tracker",
            compare=True,
            out=None,
            model=None,
            changes=(),
            tolerant=False,
            strict=False,
            ignored=(),
            least=10,
            rrd=tmp_path / "a.rrd",
            json_file=None,
        )
    cause = raised.value.__cause__
    assert isinstance(cause, ArithmeticError)
    assert traceback.extract_tb(cause.__traceback__)[-1].name == "fail"  # for --debug
