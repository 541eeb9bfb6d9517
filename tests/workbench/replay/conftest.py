"""A drive of the demo's simulator through the real cores in one process, as a recorder would write it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from eigenscan.cli.main import app
from eigenscan.eigenspace.folder import write_models
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.loopback import Loopback
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.one_thread import THREADS
from eigenscan.workbench.simulation.stage import Scenario, Stage, Timed
from eigenscan.workbench.simulation.world import office
from google.protobuf.message import Message
from typer.testing import CliRunner

SECONDS = 8.0
LATENCY_NS = 3_000_000


@dataclass(frozen=True)
class Run:
    """What was recorded: `messages` in order, with their log times."""

    messages: tuple[Timed, ...]
    models: tuple[Envelope, ...]
    folder: Path

    def write(
        self,
        path: Path,
        messages: Sequence[Timed] | None = None,
        settings: dict[str, str] | None = None,
    ) -> Path:
        """A recording of `messages`, of all of them without."""
        metadata = {name: {"settings": text} for name, text in (settings or {}).items()}
        with RecordingWriter(path, metadata) as writer:
            for timed in self.messages if messages is None else messages:
                writer.write(timed.envelope, timed.time)
        return path


def drive(
    models: Sequence[Envelope],
    scenario: Scenario,
    tracker: TrackerSettings,
    exchanged: Sequence[Envelope] = (),
) -> list[Timed]:
    """All messages of a run, models after the first inputs, as a recorder that came late would log them.

    `exchanged` models replace them half-way.
    """
    stage = Stage(office().render(), scenario)
    loop = Loopback(
        [
            ScanIngestCore(ScanIngestSettings()),
            ProjectorCore(ProjectorSettings()),
            TrackerCore(tracker),
        ]
    )
    loop.start()
    for model in models:
        loop.receive(model)
    logged = []
    inputs = list(stage.messages())
    for place, timed in enumerate(inputs):
        for model in exchanged if place == len(inputs) // 2 else ():
            logged.append(Timed(timed.time, model))
            loop.receive(model)
        logged.append(timed)
        logged += [Timed(timed.time + LATENCY_NS, published) for published in loop.receive(timed.envelope)]
    logged += [Timed(timed.time + LATENCY_NS, published) for published in loop.finish()]
    logged[5:5] = [Timed(logged[5].time, model) for model in models]
    return logged


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("models") / "office"
    site = build_site(office().render(), Plan())
    write_models(site, folder)
    models = tuple(MapbuilderCore(MapbuilderSettings(), site).start())
    messages = drive(models, Scenario(seconds=SECONDS), TrackerSettings())
    return Run(tuple(messages), models, folder)


@pytest.fixture(scope="session")
def recording(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run with the settings it had."""
    text = json.dumps({"robot": "*"})
    services = ("scan-ingest", "projector", "tracker")
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    return run.write(path, settings=dict.fromkeys(services, text))


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str


Command = Callable[..., Ended]


@pytest.fixture
def eigenscan(monkeypatch: pytest.MonkeyPatch) -> Command:
    """Runs the command in this process; what it does to the environment ends with the test."""

    def call(*arguments: object) -> Ended:
        with monkeypatch.context() as patch:
            for name in THREADS:
                patch.setenv(name, "1")
            result = CliRunner().invoke(app, [*map(str, arguments)])
        return Ended(result.exit_code, result.stdout, result.stderr)

    return call


def changed(message: Message, **fields: object) -> Message:
    """A copy with other values; `pose__x` is the field x of pose."""
    copy = type(message)()
    copy.CopyFrom(message)
    for path, value in fields.items():
        *around, name = path.split("__")
        place = copy
        for part in around:
            place = getattr(place, part)
        setattr(place, name, value)
    return copy
