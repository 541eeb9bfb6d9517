import json
from pathlib import Path

import pytest
import zenoh
from eigenscan.runtime.session import URGENT_BATCHES, open_session

SIZES = "transport/link/tx/queue/size"


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, int]]:
    """The queue sizes of each session that is opened."""
    sizes: list[dict[str, int]] = []
    really_open = zenoh.open

    def spy(config: zenoh.Config) -> zenoh.Session:
        sizes.append(json.loads(config.get_json(SIZES)))
        return really_open(config)

    monkeypatch.setattr(zenoh, "open", spy)
    return sizes


def test_urgent_messages_find_room_unless_the_file_says_otherwise(
    opened: list[dict[str, int]], tmp_path: Path
) -> None:
    alone = {"mode": "peer", "scouting": {"multicast": {"enabled": False}}}
    plain, own = tmp_path / "plain.json5", tmp_path / "own.json5"
    plain.write_text(json.dumps(alone))
    own.write_text(json.dumps(alone | {"transport": {"link": {"tx": {"queue": {"size": {"real_time": 4}}}}}}))
    for path in (plain, own):
        open_session(path).close()
    assert [sizes["real_time"] for sizes in opened] == [URGENT_BATCHES, 4]
    assert opened[0]["interactive_high"] == URGENT_BATCHES
    assert opened[1]["interactive_high"] < URGENT_BATCHES
    assert opened[0]["data"] == opened[1]["data"]
