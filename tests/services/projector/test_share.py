"""Several projectors that share a site."""

import numpy as np
import pytest
from eigenscan.projector.candidates import Candidates, Projected
from eigenscan.projector.options import ProjectorOptions
from eigenscan.projector.publishing import reported_regions
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.share import own_share
from eigenscan.projector.subspaces import SeenPart
from eigenscan.schemas.health_pb2 import Health
from pydantic import ValidationError

from tests.services.projector.office import free_poses, is_right, poses_of, ready, receive, scan_at, site

# written out, not taken from what is tested: a change there must show here
REPORTED = 64


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_every_region_has_one_projector(parts: int) -> None:
    regions = site().regions
    shares = [own_share(tuple(reversed(regions)), (k, parts)) for k in range(1, parts + 1)]
    names = [model.region for share in shares for model in share]
    assert sorted(names) == sorted(model.region for model in regions)
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


def test_more_parts_than_regions_are_refused_by_name() -> None:
    count = len(site().regions)
    core = ready(part=f"{count + 1}/{count + 1}")
    condition = core.condition()
    assert condition.status == Health.STATUS_WAITING
    assert f"only {count} regions" in condition.detail


@pytest.mark.parametrize("part", ["0/2", "3/2", "1", "1/0", "a/b"])
def test_a_part_that_is_none_is_refused(part: str) -> None:
    with pytest.raises(ValidationError, match="part"):
        ProjectorSettings(part=part)


def test_parts_are_called_by_other_names_without_a_request() -> None:
    def name(**given: str) -> str:
        return ProjectorOptions.model_validate(given).instance

    assert [name(robot="*", part=f"{k}/2") for k in (1, 2)] == ["0-1of2", "0-2of2"]
    assert name(robot="r17", part="1/1") == "r17"
    assert name(robot="a-*", part="2/3") == "a-+-2of3"
    assert name(part="1/2", instance="left") == "left"
    with pytest.raises(ValidationError) as error:
        name(robot="a/b", part="1/2")
    assert {fault["loc"] for fault in error.value.errors()} == {("robot",), ("instance",)}


def test_the_lists_of_all_parts_are_as_good_as_one_list() -> None:
    whole = ready()
    halves = [ready(part=f"{k}/2", instance=str(k)) for k in (1, 2)]
    alone = together = 0
    nearly = []
    for i, truth in enumerate(free_poses(40, 141)):
        scan = scan_at(truth, field_of_view=np.deg2rad(270), seed=i)
        one = receive(whole, scan)[0]
        several = [receive(half, scan)[0] for half in halves]
        right = bool(is_right(poses_of(one)[:1], truth)[0])
        alone += right
        listed = [h for message in several for h in message.hypotheses]
        best = max(listed, key=lambda h: h.log_likelihood)
        found = bool(is_right(np.array([[best.pose.x, best.pose.y, best.pose.theta]]), truth)[0])
        together += found
        if right and found:
            nearly.append(best.log_likelihood - one.hypotheses[0].log_likelihood)
        # together they searched all of it once; what regions share is searched by both
        area = sum(message.searched_area_m2 for message in several)
        assert one.searched_area_m2 <= area < 1.5 * one.searched_area_m2
        assert all(message.unlisted_log_likelihood == 0.0 for message in several)
    assert alone >= 34
    assert together >= alone - 2
    # a likelihood means the same from one projector and from two
    assert abs(np.median(nearly)) < 2.0


@pytest.mark.parametrize("listed", [30, 64, 65, 100])
def test_a_message_does_not_grow_with_the_site(listed: int) -> None:
    """Of 65 poses, 63 of the best regions were reported besides the listed ones; of 64 poses none."""
    rng = np.random.default_rng(0)
    count, region = 3000, rng.integers(0, 3000, listed)
    part = SeenPart(np.zeros(count), np.zeros((count, 4)), np.zeros((count, 4, 4)))
    every = np.ones(count, bool)
    projected = Projected(
        rng.normal(size=(count, 4)), rng.uniform(0, 1, count), every, every, part, lacking=0.0
    )
    none = np.empty(listed)
    reported = reported_regions(
        Candidates(np.empty((listed, 3)), np.empty((listed, 3, 3)), none, none, region, projected, 0.0, 0.0)
    )
    assert len(reported) <= max(REPORTED, listed)
    assert np.isin(region, reported).all()
    assert np.isin(np.argsort(projected.error_energy)[: max(min(30, REPORTED - listed), 0)], reported).all()
