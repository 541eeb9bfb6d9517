"""mapbuilder and `eigenscan build` as a user meets them: processes, files, Zenoh."""

import json
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path
from typing import Any

import pytest
from eigenscan.eigenspace.folder import read_models
from eigenscan.eigenspace.model import RegionModel
from eigenscan.geometry.gridmap import GridMap, from_message, write_map
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import MAP, MODEL, MODEL_SET
from eigenscan.schemas.wire import decode

from tests.network import free_port

pytestmark = pytest.mark.slow

PATIENCE_S = 240


def build(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "eigenscan.cli.main", "build", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


def test_build_writes_models_and_shows_them_on_one_screen(office: GridMap, tmp_path: Path) -> None:
    write_map(office, tmp_path / "map.yaml")
    result = build(tmp_path / "map.yaml", "-o", tmp_path / "model", "--spacing", "0.25", "--step", "2")
    assert result.returncode == 0, result.stderr
    site = read_models(tmp_path / "model")
    assert (tmp_path / "model/regions.png").stat().st_size > 1000
    assert len(result.stdout.splitlines()) <= 20
    for part in ("regions", " 3", "0.25 m apart", site.to_message().version[:12], "regions.png", "MB"):
        assert part in result.stdout


@pytest.mark.parametrize(
    ("yaml", "arguments", "stated"),
    [
        ("image: map.pgm\norigin: [0, 0, 0]\n", [], "resolution is missing"),
        (None, [], "cannot be read"),
        ("whole", ["--clearance", "4"], "no free position"),
        ("whole", ["-o", "."], "holds no models"),
    ],
)
def test_a_users_error_is_one_line_and_leaves_nothing(
    office: GridMap, tmp_path: Path, yaml: str | None, arguments: list[str], stated: str
) -> None:
    write_map(office, tmp_path / "map.yaml")
    if yaml is None:
        (tmp_path / "map.yaml").unlink()
    elif yaml != "whole":
        (tmp_path / "map.yaml").write_text(yaml)
    before = sorted(p.name for p in tmp_path.iterdir())
    where = ["-o", tmp_path] if "-o" in arguments else ["-o", tmp_path / "model", *arguments]
    result = build(tmp_path / "map.yaml", "--step", "2", *where)
    assert result.returncode == 2
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("eigenscan build: ")
    assert stated in line
    assert str(tmp_path) in line
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_a_late_joiner_gets_the_whole_set_from_the_service(office: GridMap, tmp_path: Path) -> None:
    write_map(office, tmp_path / "map.yaml")
    alone = {"scouting": {"multicast": {"enabled": False}}}
    site, port = f"t{uuid.uuid4().hex[:8]}", free_port()
    service, ours = tmp_path / "service.json5", tmp_path / "ours.json5"
    service.write_text(json.dumps(alone | {"listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}))
    ours.write_text(
        json.dumps(alone | {"listen": {"endpoints": []}, "connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]}})
    )
    flags = ["--map", tmp_path / "map.yaml", "--site", site, "--step", "2", "--zenoh", service]
    process = subprocess.Popen(
        [sys.executable, "-m", "eigenscan.mapbuilder.node", *map(str, flags)],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if '"ready"' in line:
                break
        else:
            pytest.fail("the service ended before it was ready")
        received = _listen(ours, site)
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    models = {key: RegionModel.from_message(m) for key, m in received.items() if "/model/" in key}
    entries = received[f"{site}/models"].entries
    assert [entry.version for entry in entries] == [
        models[f"{site}/model/{e.region}"].version for e in entries
    ]
    assert from_message(received[f"{site}/map"]).version == received[f"{site}/models"].map_version


def _listen(config: Path, site: str) -> dict[str, Any]:
    inbox, received = Inbox(), dict[str, Any]()
    with Bus(open_session(config)) as bus:
        bus.listen((MAP, MODEL, MODEL_SET), {"site": site}, inbox)
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline and len(received) < 5:
            arrival = inbox.take(0.2)
            if arrival is not None:
                received[arrival.key] = decode(arrival.channel, arrival.payload, arrival.encoding)
    return received


@pytest.mark.parametrize(
    ("flags", "stated"),
    [
        (["--spacing", "-1", "--map", "m.yaml"], "spacing"),
        (["--model", "absent"], "manifest.json"),
    ],
)
def test_the_service_shows_a_wrong_setting_in_one_line(flags: list[str], stated: str, tmp_path: Path) -> None:
    config = tmp_path / "z.json5"
    config.write_text(json.dumps({"scouting": {"multicast": {"enabled": False}}}))
    result = subprocess.run(
        [sys.executable, "-m", "eigenscan.mapbuilder.node", *flags, "--zenoh", str(config)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert result.returncode == 2
    assert stated in result.stderr
    assert "Traceback" not in result.stderr
