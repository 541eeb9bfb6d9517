"""A dictionary that forgets."""

import pytest
from eigenscan.schemas import recently_used
from eigenscan.schemas.recently_used import RecentlyUsed
from hypothesis import given
from hypothesis import strategies as st

AMONG = 5


@given(st.lists(st.integers(0, 8), max_size=60))
def test_just_what_was_used_among_the_last_uses_is_remembered(keys: list[int]) -> None:
    gone: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recently_used, "AMONG", AMONG)
        kept: RecentlyUsed[int, list[int]] = RecentlyUsed(lambda value: gone.append(value[0]))
    for number, key in enumerate(keys):
        fresh = key not in keys[max(0, number - AMONG) : number]
        value = kept.use(key, lambda key=key: [key])  # type: ignore[misc]
        assert value[0] == key
        assert (len(value) == 1) == fresh
        value.append(number)
        assert len(kept) <= AMONG
    remembered = {key for key, _ in kept.items()}
    assert remembered == set(keys[-AMONG:])
    assert sorted(gone) == sorted(
        key
        for number, key in enumerate(keys)
        if key not in keys[number + 1 : number + AMONG + 1] and number + AMONG < len(keys)
    )


def test_to_look_at_something_is_no_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recently_used, "AMONG", 2)
    kept: RecentlyUsed[str, int] = RecentlyUsed()
    kept.use("a", lambda: 1)
    kept.use("b", lambda: 2)
    assert kept.get("a") == 1
    kept.use("c", lambda: 3)
    assert kept.get("a") is None
    assert (kept.get("b"), kept.get("c")) == (2, 3)
