"""How much of what the lidar sees the map explains, at claims."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.pose import to_message
from eigenscan.schemas.channels import HYPOTHESES, POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, PoseEstimate, State
from eigenscan.workbench.evaluation.explained import LITTLE, explained_at_claims
from eigenscan.workbench.evaluation.log import read_log
from eigenscan.workbench.evaluation.report import remarks
from eigenscan.workbench.logs import LogOptions
from eigenscan.workbench.logs.remarks import remarks as of_reading

from tests.workbench.logs.test_ros import START, usual

ROBOT = {"site": "s", "robot": "r"}


def listed(time: int, *of: tuple[float, float]) -> Envelope:
    """Hypotheses on the x axis, each with the share of the beams that it explains."""
    message = Hypotheses(timestamp=stamp(time))
    for x, explained in of:
        message.hypotheses.append(Hypothesis(pose=to_message(np.array([x, 0.0, 0.0])), explained=explained))
    return Envelope(HYPOTHESES, {**ROBOT, "lidar": "front", "projector": "0"}, message)


def claimed(time: int, x: float, state: State = STATE_LOCALIZED) -> Envelope:
    pose = to_message(np.array([x, 0.0, 0.0]))
    return Envelope(POSE, ROBOT, PoseEstimate(timestamp=stamp(time), pose=pose, state=state))


def test_the_likeliest_hypothesis_at_the_claimed_pose_counts() -> None:
    published = [
        listed(1, (9.0, 0.95), (2.1, 0.6), (2.2, 0.7)),
        listed(2, (9.0, 0.95)),
        claimed(1, 2.0),
        claimed(2, 2.0),  # its place is not in the list
        listed(3, (2.0, 0.8)),
        claimed(3, 2.0, STATE_AMBIGUOUS),
        claimed(4, 2.0),  # no list of that stamp
    ]
    assert explained_at_claims(published).tolist() == pytest.approx([0.6])
    assert explained_at_claims([]).tolist() == []


def test_what_the_reader_counted_is_remarked_in_the_words_of_import(tmp_path: Path) -> None:
    story = usual(False, 1)
    story.scan("/lost/scan", START + 0.5, "lost")
    log = read_log(story.write(tmp_path / "a"), LogOptions(lidars=("lost",)), lambda _: None)
    assert log.set_aside == {"lidars_without_mount": 1}
    figures = {
        "log": {"odometry": 9, "set_aside": log.set_aside},
        "map_explains": {"median": None, "p5": None},
        "normalised_innovation_squared": {"consistency": {"mean": None, "high": None}},
    }
    (remark,) = remarks(figures)
    assert [remark] == [f"in the log, {line}" for line in of_reading(log.set_aside)]
    assert "lidars without mount: 1 (" in remark
    assert "import --mount" in remark


@pytest.mark.parametrize(("median", "count"), [(LITTLE - 0.1, 1), (LITTLE + 0.1, 0), (None, 0)])
def test_a_map_that_explains_little_is_remarked(median: float | None, count: int) -> None:
    figures = {
        "log": {"odometry": 9},
        "map_explains": {"median": median, "p5": median},
        "normalised_innovation_squared": {"consistency": {"mean": None, "high": None}},
    }
    found = remarks(figures)
    assert len(found) == count
    assert all("65 %" in remark for remark in found)
