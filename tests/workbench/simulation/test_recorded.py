"""The demo's real drive, as a `Stage` that was recorded."""

import itertools

import numpy as np
from eigenscan.geometry.gridmap import OCCUPIED
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW, TRUTH
from eigenscan.workbench.simulation.recorded import CARRIED_M, INTEL, Recorded

EPOCH = 1_700_000_000_000_000_000


def test_it_is_stamped_from_the_epoch_on_and_under_the_names_that_were_declared() -> None:
    stage = Recorded(INTEL, "here")
    stage.epoch = EPOCH
    timed = list(stage.messages())
    assert timed[0].time == EPOCH
    assert all(each.time == each.envelope.stamp for each in timed)
    assert all(a.time <= b.time for a, b in itertools.pairwise(timed))
    assert {each.envelope.key for each in timed} == {*stage.keys}
    assert all(key.startswith("here/") or "/here/" in key for key in stage.keys)
    assert timed[-1].time - EPOCH <= (stage.scenario.seconds + 0.5) * 1e9


def test_each_scan_has_a_truth_outside_walls_and_one_jump_lies_between_two() -> None:
    stage = Recorded(INTEL, "here")
    channels = [each.envelope.channel for each in stage.messages()]
    assert channels.count(SCAN_RAW) == channels.count(TRUTH) == len(stage.poses)
    assert ODOMETRY in channels
    grid, (x, y) = stage.grid, stage.poses[:, :2].T
    column = ((x - grid.origin[0]) / grid.resolution).astype(int)
    row = ((y - grid.origin[1]) / grid.resolution).astype(int)
    assert not np.any(grid.cells[row, column] == OCCUPIED)
    assert len(stage.jumps) == 1
    at = stage.kidnap_time
    assert at is not None
    before, after = stage.pose_at(at - 100_000_000), stage.pose_at(at)
    assert np.hypot(*(after - before)[:2]) > CARRIED_M


def test_a_later_epoch_moves_the_kidnap_with_it() -> None:
    stage = Recorded(INTEL, "here")
    first = stage.kidnap_time
    assert first is not None
    stage.epoch += 5
    assert stage.kidnap_time == first + 5
    assert np.array_equal(stage.pose_at(first + 5), stage.poses[stage.jumps[0]])
