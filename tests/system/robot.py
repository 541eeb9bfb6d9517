"""A simulated robot that drives through a wing of an office while services come and go."""

import threading
import time
from pathlib import Path

from eigenscan.geometry.gridmap import write_map
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import ODOMETRY
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.conformance.generation import wing
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office


class Robot:
    """Drives on in the background, at the pace of the clock, with odometry or without."""

    def __init__(self, site: str, config: Path) -> None:
        self.stage = Stage(
            wing(office()).render(),
            Scenario(seconds=600.0, seed=5, people=1, lidar=Lidar(beams=181, rate=5.0), site=site),
        )
        self.odometry = threading.Event()
        self.odometry.set()
        self._stop = threading.Event()
        self._bus = Bus(open_session(config))
        self._thread = threading.Thread(
            target=publish, args=(self.stage.messages(), self._publish, 1.0, self._stop)
        )

    def write_map(self, folder: Path) -> Path:
        """The map it drives through."""
        write_map(self.stage.grid, folder / "map.yaml")
        return folder / "map.yaml"

    def _publish(self, envelope: Envelope) -> None:
        if envelope.channel is not ODOMETRY or self.odometry.is_set():
            self._bus.publish(envelope)

    def __enter__(self) -> "Robot":
        self.stage.epoch = time.time_ns()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._bus.close()
