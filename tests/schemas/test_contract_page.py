import re
from pathlib import Path

import pytest
from eigenscan.schemas.channels import CHANNELS, Channel
from eigenscan.schemas.page import fill, main
from eigenscan.schemas.wire import encoding

from tests.environment import ROOT

PAGE = ROOT / "docs/contract.md"


def test_the_page_is_current() -> None:
    assert main([str(PAGE), "--check"]) == 0


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.name)
def test_every_channel_is_reported_whole(channel: Channel) -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert f"`{channel.template}`" in text
    assert f"| `{channel.template}` | `{channel.schema_name}` |" in text
    assert encoding(channel) == f"application/protobuf;{channel.schema_name}/1"  # as the page states in words
    (row,) = [
        line
        for line in text.splitlines()
        if line.startswith(f"| `{channel.name}` | {channel.qos.priority.name}")
    ]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[2] == ("block" if channel.qos.block else "drop")
    assert (cells[3], cells[4]) == (
        "yes" if channel.qos.express else "",
        "yes" if channel.qos.latched else "",
    )
    assert channel.about


def test_a_changed_table_is_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stale = tmp_path / "contract.md"
    stale.write_text(
        PAGE.read_text(encoding="utf-8").replace("{site}/models", "{site}/model_set"), encoding="utf-8"
    )
    assert main([str(stale), "--check"]) == 1
    assert "not current" in capsys.readouterr().err
    assert main([str(stale)]) == 0
    assert stale.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")


def test_a_page_without_its_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="keys"):
        fill("# The contract")


def test_its_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\((?!http)([^)#]+)", PAGE.read_text(encoding="utf-8")):
        assert (PAGE.parent / target).exists(), target
