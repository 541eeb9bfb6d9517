"""Answers every scan, in Zenoh's own thread, with a model that must not be lost."""

import sys
import threading
from pathlib import Path
from typing import Any

from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import MODEL, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import RegionModel


def main(config: str, site: str, model_bytes: int) -> None:
    """Until it is ended."""
    session = open_session(Path(config))
    bus = Bus(session)

    def answer(_sample: Any) -> None:
        model = RegionModel(region="hall", version="1", panoramas=bytes(model_bytes))
        bus.publish(Envelope(MODEL, {"site": site, "region": "hall"}, model))

    subscriber = session.declare_subscriber(SCAN.selector({"site": site}), answer)
    print("ready", flush=True)
    threading.Event().wait()
    subscriber.undeclare()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
