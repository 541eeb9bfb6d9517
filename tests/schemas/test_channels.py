import pytest
import zenoh
from eigenscan.schemas.channels import (
    CHANNELS,
    MODEL,
    SCAN,
    SCAN_RAW,
    Channel,
    ContractError,
    by_name,
    find,
    is_chunk,
)
from hypothesis import given
from hypothesis import strategies as st

# any text without what Zenoh or the contract keeps for itself
CHUNKS = st.text(
    st.characters(exclude_characters="/*$#?@", exclude_categories=("Cs", "Cc", "Z")), min_size=1, max_size=12
)
FIELDS = sorted({name for channel in CHANNELS for name in channel.fields})
ADDRESSES = st.fixed_dictionaries(dict.fromkeys(FIELDS, CHUNKS))


@given(st.sampled_from(CHANNELS), ADDRESSES)
def test_a_built_key_is_parsed_back_by_its_own_channel_only(
    channel: Channel, address: dict[str, str]
) -> None:
    key = channel.key(address)
    own = {name: address[name] for name in channel.fields}
    assert [(one.name, found) for one in CHANNELS if (found := one.parse(key)) is not None] == [
        (channel.name, own)
    ]
    assert find(key) == (channel, own)


@given(st.sampled_from(CHANNELS), ADDRESSES, st.data())
def test_zenoh_takes_the_key_and_the_selector_covers_it(
    channel: Channel, address: dict[str, str], data: st.DataObject
) -> None:
    key = zenoh.KeyExpr(channel.key(address))
    given_fields = data.draw(st.sets(st.sampled_from(channel.fields)))
    selector = zenoh.KeyExpr(channel.selector({name: address[name] for name in given_fields}))
    assert selector.includes(key)
    for other in CHANNELS:
        if other is not channel:
            assert not zenoh.KeyExpr(other.selector()).intersects(key)


@given(
    st.sampled_from(CHANNELS),
    ADDRESSES,
    st.sampled_from(["", "a/b", "*", "a b", "**", "a#", "$*", "@x", "a?", "a\x1b[2J", "a\x9bm", "a\udcff"]),
)
def test_what_is_no_plain_chunk_makes_no_key(channel: Channel, address: dict[str, str], bad: str) -> None:
    for name in channel.fields:
        with pytest.raises(ContractError, match=name):
            channel.key(address | {name: bad})
    assert not is_chunk(bad)


@pytest.mark.parametrize("bad", ["", "a/b", "**", "a b", "@x"])
def test_what_is_no_plain_chunk_makes_no_selector(bad: str) -> None:
    with pytest.raises(ContractError, match="site"):
        SCAN.selector({"site": bad})


def test_a_missing_field_is_named() -> None:
    with pytest.raises(ContractError, match="lidar"):
        SCAN.key({"site": "s", "robot": "r"})


@given(st.text(max_size=60))
def test_any_text_is_a_key_or_not_but_never_an_error(key: str) -> None:
    found = find(key)
    assert found is None or found[0].key(found[1]) == key


def test_keys_that_are_not_ours() -> None:
    for key in (
        "",
        "s",
        "s/robot/r/scan",
        "s/robot/r/scan/a/b",
        "s/model",
        "s/model/r/x",
        "/s/map",
        "s/map/",
    ):
        assert find(key) is None
    assert find("s/robot/r/scan/raw/front") == (
        SCAN_RAW,
        {"site": "s", "robot": "r", "lidar": "front"},
    )


def test_names_are_unique_and_found() -> None:
    assert len({channel.name for channel in CHANNELS}) == len(CHANNELS)
    assert by_name("model") is MODEL
    with pytest.raises(ContractError, match=r"no channel 'scam'.*scan"):
        by_name("scam")


def test_what_must_not_be_lost_is_kept_for_who_comes_late() -> None:
    for channel in CHANNELS:
        if channel.qos.latched:
            assert channel.qos.block
            assert channel.qos.depth == 0
        else:
            assert channel.qos.depth > 0
