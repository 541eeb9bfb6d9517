"""A real drive as a recording, and a site to play it into."""

import json
import os
import subprocess
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.workbench.logs import open_log

from tests.environment import PROGRAMS
from tests.network import PATIENT_QUEUE, free_port
from tests.system.house import BEGIN_S, INTEL, LENGTH_S, ONE_THREAD, PATIENCE_S, SPACING, Drive, Ear, House


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("drive")
    taken = []
    with RecordingWriter(folder / "intel.mcap") as writer:
        for envelope in open_log(INTEL / "log.clf.gz").envelopes():
            at = envelope.stamp * 1e-9 - BEGIN_S
            if at > LENGTH_S:
                break
            if at >= 0.0:
                writer.write(envelope, envelope.stamp)
                taken.append(envelope)
    return Drive(folder / "intel.mcap", INTEL / "map.yaml", taken)


@pytest.fixture(scope="session")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The models of the drive's map, built once."""
    folder = tmp_path_factory.mktemp("models") / "intel"
    subprocess.run(
        [PROGRAMS / "eigenscan", "build", INTEL / "map.yaml", "-o", folder, "--spacing", str(SPACING)],
        check=True,
        capture_output=True,
        env=os.environ | ONE_THREAD,
    )
    return folder


@pytest.fixture
def house(tmp_path: Path) -> Iterator[House]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    alone = {
        "scouting": {"multicast": {"enabled": False}},
        # a busy machine must not lose what the test counts
        "transport": {"link": {"tx": {"queue": PATIENT_QUEUE}}},
    }
    leaf = tmp_path / "leaf.json5"
    leaf.write_text(json.dumps(alone | {"mode": "client", "connect": {"endpoints": [endpoint]}}))
    router = zenoh.Config.from_json5(
        json.dumps(alone | {"mode": "router", "listen": {"endpoints": [endpoint]}})
    )
    site = f"test-{uuid.uuid4().hex[:12]}"
    with zenoh.open(router) as session:
        ear = Ear()
        session.declare_subscriber(f"{site}/**", ear.on_sample)
        house = House(site, leaf, session, ear, tmp_path)
        yield house
        for process in house.running.values():
            process.kill()
            process.wait(PATIENCE_S)
