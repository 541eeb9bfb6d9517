"""Groups of robots by names and patterns."""

import pytest
import zenoh
from eigenscan.schemas.channels import HEALTH, MAP, SCAN, ContractError, is_chunk
from eigenscan.schemas.group import holds, instance_name, is_one, patterns, selectors
from hypothesis import given
from hypothesis import strategies as st

NAMES = st.text("ab-1", min_size=1, max_size=4)
GROUPS = st.lists(st.text("ab-1*", min_size=1, max_size=4), min_size=1, max_size=3).map(",".join)


@given(GROUPS, NAMES)
def test_a_group_holds_just_the_robots_whose_keys_its_selectors_match(group: str, robot: str) -> None:
    key = zenoh.KeyExpr(SCAN.key({"site": "s", "robot": robot, "lidar": "front"}))
    matched = [zenoh.KeyExpr(one).intersects(key) for one in selectors(SCAN, {"site": "s", "robot": group})]
    assert holds(group, robot) == any(matched)


@given(GROUPS)
def test_an_instance_is_called_by_a_name_that_a_key_may_hold(group: str) -> None:
    assert is_chunk(instance_name(group))


@given(GROUPS, GROUPS)
def test_other_groups_give_other_names(one: str, other: str) -> None:
    assert (patterns(one) == patterns(other)) == (instance_name(one) == instance_name(other))


def test_one_robot_is_distinguished_from_several() -> None:
    assert is_one("r17")
    assert not any(map(is_one, ("*", "r*", "r1,r2")))


def test_other_fields_are_as_they_were() -> None:
    group = {"site": "s", "robot": "a-*,b-7"}
    assert selectors(MAP, group) == ("s/map",)
    assert selectors(HEALTH, {"site": "s", "service": "tracker"}) == ("s/health/tracker/*",)
    assert selectors(SCAN, {"robot": "r1", "lidar": "front"}) == ("*/robot/r1/scan/front",)


@pytest.mark.parametrize("group", ["", "a,", "a b", "a/b", "$*", "a?", "#", "@a"])
def test_what_is_no_name_is_refused(group: str) -> None:
    with pytest.raises(ContractError, match="is no robot"):
        patterns(group)


def test_no_pattern_takes_long() -> None:
    """With a regular expression this took longer than anybody waits."""
    assert not holds("*a" * 40 + "b", "a" * 5000)
    assert holds("*a" * 40, "a" * 5000)


def test_a_group_of_thousands_is_refused() -> None:
    with pytest.raises(ContractError, match="more than 200"):
        patterns(",".join(f"r{number}" for number in range(5000)))
