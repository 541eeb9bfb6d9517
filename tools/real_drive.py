"""Makes the demo's real drive: two short stretches of a log, joined by a kidnap, with reference and map.

    .venv/bin/python tools/real_drive.py ../shared/datasets/intel

The folder holds map.yaml, log.clf.gz and its reference log.tum. The stretches are those of tools/film.py.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from eigenscan.geometry.gridmap import read_map
from eigenscan.geometry.pose import to_pose3
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.channels import SCAN_RAW, TRUTH
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.workbench.evaluation.kidnap import splice
from eigenscan.workbench.evaluation.log import read_log
from eigenscan.workbench.evaluation.reference import read_trajectory
from eigenscan.workbench.evaluation.windows import Window
from eigenscan.workbench.logs import LogOptions
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from PIL import Image

NS = 1_000_000_000
BEFORE, AFTER = (1000001650.55, 1000001668.05), (1000002435.49, 1000002453.0)
"""s by the log's stamps."""
OUT = Path(__file__).resolve().parents[1] / "workbench/src/eigenscan/workbench/simulation/intel"
ABOUT = {
    "building": "Intel Research Lab, Seattle",
    "recorded by": "Dirk Hähnel",
    "licence": "CC-BY-3.0",
    "changes": "two stretches of the log, joined; later stamps and odometry continue the earlier ones",
}


def main() -> None:
    """Writes map and recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path, nargs="?", default=OUT)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    _save_map(given.folder, given.out)
    log = read_log(given.folder / "log.clf.gz", LogOptions(), lambda _: None)
    reference = read_trajectory(given.folder / "log.tum")
    before, after = (Window(round(a * NS), round(b * NS)) for a, b in (BEFORE, AFTER))
    joined = splice(log.between(before), log.between(after))
    with RecordingWriter(given.out / "drive.mcap", {"source": ABOUT}) as writer:
        for envelope in joined.received:
            if envelope.channel == SCAN_RAW:
                logged = envelope.stamp - (joined.moved if envelope.stamp >= joined.jump else 0)
                pose, known = reference.at([logged])
                assert known[0], f"the reference lacks {logged}"
                truth = PoseInFrame(timestamp=stamp(envelope.stamp), frame_id="map", pose=to_pose3(pose[0]))
                writer.write(Envelope(TRUTH, envelope.address, truth), envelope.stamp)
            writer.write(envelope, envelope.stamp)


def _save_map(folder: Path, out: Path) -> None:
    """The same map as a small image, without the unknown margin's bytes."""
    with Image.open(folder / "map.pgm") as image:
        image.save(out / "map.png", optimize=True)
    text = (folder / "map.yaml").read_text(encoding="utf-8").replace("map.pgm", "map.png")
    (out / "map.yaml").write_text(text, encoding="utf-8")
    assert read_map(out / "map.yaml").version == read_map(folder / "map.yaml").version


if __name__ == "__main__":
    main()
