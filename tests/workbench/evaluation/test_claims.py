"""Poses of any program: how they are read, and that they are judged as the pipeline's own."""

from pathlib import Path

import numpy as np
import pytest
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.evaluation.claims import (
    Claim,
    judge_claims,
    kidnaps_of,
    read_claims,
    restamped,
    save_runs,
    stream_of,
)
from eigenscan.workbench.evaluation.figures import Figures
from eigenscan.workbench.evaluation.log import Log, Received
from eigenscan.workbench.evaluation.reference import NS, EvaluationError, Trajectory
from eigenscan.workbench.evaluation.windows import Window
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

TENTH = NS // 10
NAN = float("nan")


def line(seconds: int) -> Trajectory:
    """Along x at 1 m/s, a pose each tenth of a second."""
    stamps = np.arange(seconds * 10 + 1) * TENTH
    return Trajectory(stamps, np.column_stack([stamps / NS, np.zeros((len(stamps), 2))]))


def log(seconds: int) -> Log:
    robot = {"site": "s", "robot": "r"}
    messages = []
    for index in range(seconds * 10 + 1):
        time = stamp(index * TENTH)
        messages.append(Received(index * TENTH, Envelope(ODOMETRY, robot, Odometry(timestamp=time))))
        scan = Envelope(SCAN_RAW, {**robot, "lidar": "l"}, RawScan(timestamp=time, ranges=[1.0]))
        messages.append(Received(index * TENTH, scan))
    return Log(messages)


def claims(first: int, last: int, *, off: float = 0.0, run: str = "", confidence: float = NAN) -> list[Claim]:
    """A claim each tenth of a second from `first` to `last`, s, `off` metres beside the line."""
    return [
        Claim(run, index * TENTH, (index / 10, off, 0.0), confidence, True, NAN)
        for index in range(first * 10, last * 10 + 1)
    ]


def judged(given: list[Claim], *, kidnap: bool = False) -> Figures:
    windows = [Window(0, 20 * NS), Window(30 * NS, 50 * NS)]
    return judge_claims(Path("c.csv"), given, log(60), windows, line(60), kidnap=kidnap)


def test_a_csv_is_read_by_its_header(tmp_path: Path) -> None:
    file = tmp_path / "claims.csv"
    file.write_text(
        "# made by a program\nheading,stamp,y,x,window,confidence,localized,more\n"
        "1.5,1700000000.123456789,-2,3,7,0.25,0,a\n-0.5,12,4,5,kidnap-2,,,b\n"
    )
    first, second = read_claims(file, offset_s=1.0)
    assert (first.run, first.stamp, first.pose) == ("window-7", 1700000001123456789, (3.0, -2.0, 1.5))
    assert (first.confidence, first.is_localized) == (0.25, False)
    assert (second.run, second.stamp, second.pose) == ("kidnap-2", 13 * NS, (5.0, 4.0, -0.5))
    assert np.isnan(second.confidence)
    assert second.is_localized


def test_a_spreadsheets_byte_order_mark_is_no_column(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text("stamp,x,y,heading\n1,2,3,0\n", encoding="utf-8-sig")
    assert [claim.stamp for claim in read_claims(tmp_path / "c.csv")] == [NS]


def test_a_tum_file_claims_each_of_its_poses(tmp_path: Path) -> None:
    file = tmp_path / "claims.tum"
    file.write_text("# t x y z qx qy qz qw\n1.5 2 3 0 0 0 1 0\n")
    (claim,) = read_claims(file)
    assert (claim.run, claim.stamp, claim.pose[:2]) == ("", 1_500_000_000, (2.0, 3.0))
    assert abs(claim.pose[2]) == pytest.approx(np.pi)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no pose in it"),
        ("stamp,x,y\n1,2,3\n", "line 1: column heading is missing: give stamp,x,y,heading"),
        ("1,2,3,4\n", "line 1: no header: begin with stamp,x,y,heading"),
        ("stamp,x,y,heading\n", "the header alone"),
        ("stamp,x,y,heading\n1,2,3\n", "line 2: 3 columns, the header has 4"),
        ("stamp,x,y,heading\n1,2,3,4\n\nsoon,2,3,4\n", "line 4, field stamp: 'soon': give seconds"),
        ("stamp,x,y,heading\n1,nan,3,4\n", "line 2, field x: 'nan': give metres"),
        ("stamp,x,y,heading\n1,2,3,90\n", "line 2, field heading: '90': give radians"),
        ("stamp,x,y,heading,confidence\n1,2,3,1,95\n", "field confidence: '95': give a probability, 0 to 1"),
        ("stamp,x,y,heading,localized\n1,2,3,1,yes\n", "field localized: 'yes': give 1 for a claim"),
        ("stamp,x,y,heading,window\n1,2,3,1,first\n", "field window: 'first': give 7 or window-7"),
        ("1 2 3\n", "line 1: '1 2 3': give t x y z qx qy qz qw"),
    ],
)
def test_what_is_wrong_is_named_with_file_line_field_and_fix(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "claims.csv"
    file.write_text(text)
    with pytest.raises(EvaluationError) as caught:
        read_claims(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert message in str(caught.value)


def test_right_claims_succeed_and_wrong_ones_are_false() -> None:
    figures = judged([*claims(0, 20, run="window-0"), *claims(30, 50, run="window-1", off=0.6)])
    right, wrong = figures["per_window"]
    assert (right["success"], right["false_claims"], right["scans"]) == (True, 0, 201)
    assert (wrong["success"], wrong["false_claims"]) == (False, 201)
    assert figures["success_rate"] == figures["false_claim_rate"] == 0.5
    assert figures["kidnap"] is None
    assert figures["calibration_error"] is None


def test_a_program_that_is_silent_but_for_the_end_does_not_succeed() -> None:
    late, early = claims(19, 20), claims(10, 20)
    assert not judged(late)["per_window"][0]["success"]
    found = judged(early)["per_window"][0]
    assert found["success"]
    assert found["to_localize"]["scans"] == 100


def test_poses_at_a_tenth_of_the_scans_rate_cover_the_scans_between() -> None:
    given = claims(0, 20)[::10]
    assert len(stream_of(given, log(20).scans)) == len(given)
    assert judged(given)["per_window"][0]["success"]


def test_confidence_is_calibrated_against_what_was_right() -> None:
    sure = claims(0, 20, confidence=0.9) + claims(30, 50, off=5.0, confidence=0.9)
    assert judged(sure)["calibration_error"] == pytest.approx(0.4, abs=1e-9)


def test_kidnaps_are_judged_by_the_runs_that_were_saved(tmp_path: Path) -> None:
    source, reference = log(60), line(60)
    windows = [Window(0, 20 * NS), Window(30 * NS, 50 * NS)]
    files = save_runs(tmp_path, source, windows, reference, kidnap=True)
    assert [file.name for file in files] == [
        *("window-0.mcap", "window-1.mcap", "kidnap-0.mcap", "kidnap-1.mcap")
    ]
    given = []
    for name, spliced in kidnaps_of(source, windows, reference):
        scans = [record.envelope.stamp for record in read(tmp_path / f"{name}.mcap")]
        for when in sorted(set(scans)):
            # right before the jump, and from 2 s after it
            truth = when if when < spliced.jump else when - spliced.moved
            off = 1.0 if spliced.jump <= when < spliced.jump + 2 * NS else 0.0
            given.append(Claim(name, when, (truth / NS, off, 0.0), NAN, True, NAN))
    found = judged([*claims(0, 20), *given])["kidnap"]
    assert found["kidnaps"] == 2
    assert found["recovered_within_3_s"] == 1.0
    assert found["recovered_s"]["median"] == pytest.approx(2.0, abs=0.11)


def test_runs_that_are_not_there_and_stamps_of_another_log_are_refused() -> None:
    with pytest.raises(EvaluationError, match="window window-7: choose one of window-0 to window-1"):
        judged(claims(0, 20, run="window-7"))
    with pytest.raises(EvaluationError, match="no stamp within a window"):
        judged(claims(55, 60))


def test_claims_with_the_logs_own_stamps_follow_the_logs_repair() -> None:
    own, saved = claims(1, 1), claims(1, 1, run="window-0")
    moved = {2 * NS: 1 * NS}
    assert [claim.stamp for claim in restamped([*own, *saved], moved)] == [2 * NS, 1 * NS]


def test_kidnaps_that_claims_do_not_hold_are_not_judged() -> None:
    with pytest.raises(EvaluationError, match="has no kidnap run"):
        judged(claims(0, 20), kidnap=True)
