"""MRPT's particle filter, `pf-localization` (Debian: apt-get install mrpt-apps), on runs saved by Eigenscan.

    .venv/bin/python benchmarks/peers/mrpt_pf_localization.py RUNS MAP.yaml --poses OUT.csv

It writes each run as MRPT's rawlog and the map as its gridmap, and starts the program once a run, uniformly
over the free cells. The mean pose that it prints for each scan is the claim: the filter gives no verdict. The
settings are those of MRPT's demo (localization_demo.ini) but for BEAMS and the odometry's noise. KLD sampling
lowers the number of particles once the filter has converged. CPU is a mean of each run, start included.
"""

from __future__ import annotations

import argparse
import csv
import math
import re
import resource
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap, read_map
from eigenscan.geometry.pose import compose, from_message, from_pose3
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.workbench.evaluation.log import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray

PROGRAM = "pf-localization"
PARTICLES = 100_000
TICKS_A_SECOND = 10_000_000
ESTIMATE = re.compile(r"PDF estimation: \((\S+),(\S+),(\S+)deg\)")
TRIES, LONGEST_S = 3, 600
BEAMS = 36
"""Of a scan that count. Of 8 windows of intel that fail with the demo's 9, five succeed with 36."""
WORDS = (
    "localization_demo.ini of MRPT 2.5.8, 36 beams, KLD sampling, odometry noise 0.04 m and 1 deg; mean pose"
)
SETTINGS = """
[KLD_options]
KLD_binSize_PHI_deg=10
KLD_binSize_XY=0.10
KLD_delta=0.01
KLD_epsilon=0.01
KLD_maxSampleSize={particles}
KLD_minSampleSize=150
KLD_minSamplesPerBin=0

[PF_options]
PF_algorithm=0
resamplingMethod=0
adaptiveSampleSize=1
BETA=0.5
sampleSize=1

[DummyOdometryParams]
minStdXY=0.04
minStdPHI=1.0

[LocalizationExperiment]
use_3D_poses=false
map_file={folder}/map.gridmap
rawlog_file={folder}/run.rawlog
logOutput_dir={folder}/log
3DSceneFrequency=-1
experimentRepetitions=1
particles_count={particles}
init_PDF_mode=0
init_PDF_min_x=0
init_PDF_max_x={width}
init_PDF_min_y=0
init_PDF_max_y={height}
SHOW_PROGRESS_3D_REAL_TIME=false

[MetricMap]
occupancyGrid_count=1
gasGrid_count=0
pointsMap_count=0
beaconMap_count=0
likelihoodMapSelection=-1

[MetricMap_occupancyGrid_00_creationOpts]
resolution={resolution}

[MetricMap_occupancyGrid_00_likelihoodOpts]
likelihoodMethod=4
LF_decimation={decimation}
LF_stdHit=0.20
LF_maxCorrsDistance=0.30
LF_zHit=0.95
LF_zRandom=0.05
LF_maxRange=80
LF_alternateAverageMethod=0
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", type=Path, help="folder that eigenscan evaluate --save-runs wrote")
    parser.add_argument("map", type=Path, help="map_server yaml")
    parser.add_argument("--poses", type=Path, required=True, help="CSV for eigenscan evaluate --poses")
    parser.add_argument("--particles", type=int, default=PARTICLES)
    given = parser.parse_args()
    grid = read_map(given.map)
    files = sorted(given.runs.glob("*.mcap"), key=lambda file: (file.stem.split("-")[0], _number(file)))
    if not files:
        sys.exit(
            f"{given.runs}: no run in it: write them with eigenscan evaluate LOG --save-runs {given.runs}"
        )
    with given.poses.open("w", encoding="utf-8", newline="") as out:
        out.write(f"# system: MRPT pf-localization, {given.particles:,} particles\n")
        out.write(f"# settings: {WORDS}\n")
        table = csv.writer(out)
        table.writerow(("window", "stamp", "x", "y", "heading", "cpu_ms"))
        for file in files:
            before = _cpu_s()
            poses = list(localize(file, grid, given.particles))
            cpu_ms = 1e3 * (_cpu_s() - before) / max(len(poses), 1)
            for stamp, pose in poses:
                table.writerow((file.stem, f"{stamp / 1e9:.9f}", *pose.tolist(), f"{cpu_ms:.3f}"))
            out.flush()
            print(file.stem, flush=True)


def _cpu_s() -> float:
    """CPU time, s, of all programs that this one has run to their end."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _number(file: Path) -> int:
    return int(file.stem.rpartition("-")[2])


def localize(run: Path, grid: GridMap, particles: int) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Stamp, ns, and mean pose (3,) in the map frame, of each scan of a run."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "map.gridmap").write_bytes(gridmap(grid))
        envelopes = [record.envelope for record in read(run)]
        beams = [len(each.open(RawScan).ranges) for each in envelopes if each.channel is SCAN_RAW]
        stamps = write_rawlog(folder / "run.rawlog", envelopes)
        height, width = grid.cells.shape
        text = SETTINGS.format(
            particles=particles,
            folder=folder,
            width=width * grid.resolution,
            height=height * grid.resolution,
            resolution=grid.resolution,
            decimation=max(1, round(max(beams) / BEAMS)),
        )
        (folder / "settings.ini").write_text(text, encoding="utf-8")
        output = _output([PROGRAM, str(folder / "settings.ini")])
        poses = [tuple(map(float, found)) for found in ESTIMATE.findall(output)]
        if len(poses) != len(stamps):
            sys.exit(f"{run}: {PROGRAM} gave {len(poses)} poses of {len(stamps)}:\n{output[-2000:]}")
        for stamp, (x, y, degrees) in zip(stamps, poses, strict=True):
            yield stamp, compose(grid.origin, np.array([x, y, math.radians(degrees)]))


def _output(command: list[str]) -> str:
    """What the program prints. It may hang at a lock, as once in some 70 runs: then it is started again."""
    for _ in range(TRIES):
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                check=False,
                timeout=LONGEST_S,
            )
            return done.stdout
        except subprocess.TimeoutExpired:
            print(f"{command[0]}: no end after {LONGEST_S} s: again", file=sys.stderr, flush=True)
    return ""


def write_rawlog(file: Path, envelopes: list[Envelope]) -> list[int]:
    """Writes scans and odometry by stamp; the stamps, ns, of the scans."""
    stamps = list[int]()
    poses = [from_pose3(each.open(Odometry).pose) for each in envelopes if each.channel is ODOMETRY]
    first = poses[0] if poses else np.zeros(3)
    with file.open("wb") as out:
        # the filter does not run for the first message
        out.write(odometry(min(each.stamp for each in envelopes), first))
        for envelope in sorted(envelopes, key=lambda each: (each.stamp, each.channel is SCAN_RAW)):
            if envelope.channel is ODOMETRY:
                out.write(odometry(envelope.stamp, from_pose3(envelope.open(Odometry).pose)))
            elif envelope.channel is SCAN_RAW and (scan := Log.canonical(envelope)) is not None:
                out.write(observation(envelope.stamp, scan))
                stamps.append(envelope.stamp)
    return stamps


def _object(name: str, version: int, content: bytes) -> bytes:
    """An object as MRPT's CArchive writes it."""
    return bytes([0x80 | len(name)]) + name.encode() + bytes([version]) + content + b"\x88"


def gridmap(grid: GridMap) -> bytes:
    """COccupancyGridMap2D, version 0: free cells are white; its frame begins at the grid's own corner."""
    values = np.full(grid.cells.shape, 127, dtype=np.uint8)
    values[grid.cells == FREE] = 255
    values[grid.cells == OCCUPIED] = 0
    height, width = grid.cells.shape
    step = grid.resolution
    head = struct.pack("<2I5f", width, height, 0.0, width * step, 0.0, height * step, step)
    return _object("COccupancyGridMap2D", 0, head + values.tobytes())


def odometry(stamp: int, pose: NDArray[np.float64]) -> bytes:
    """CObservationOdometry, version 0."""
    inner = _object("CPose2D", 1, struct.pack("<3d", *pose))
    return _object("CObservationOdometry", 0, inner + struct.pack("<I", 0) + _ticks(stamp))


def observation(stamp: int, scan: Scan) -> bytes:
    """CObservation2DRangeScan, version 7: its beams are even about the sensor's x axis."""
    ranges = np.asarray(scan.ranges, dtype=np.float32)
    count = len(ranges)
    aperture = abs(scan.angle_increment) * (count - 1)
    middle = scan.angle_min + scan.angle_increment * (count - 1) / 2
    sensor = compose(from_message(scan.mount), np.array([0.0, 0.0, middle]))
    seen = np.isfinite(ranges) & (ranges > 0) & (ranges < scan.range_max)
    cosine, sine = math.cos(sensor[2]), math.sin(sensor[2])
    turn = (cosine, -sine, 0.0, sine, cosine, 0.0, 0.0, 0.0, 1.0)
    content = struct.pack("<f?f", aperture, scan.angle_increment > 0, scan.range_max)
    content += _object("CPose3D", 3, struct.pack("<12d", sensor[0], sensor[1], 0.0, *turn))
    content += struct.pack("<I", count) + np.where(seen, ranges, np.float32(0)).tobytes()
    content += seen.astype(np.uint8).tobytes() + struct.pack("<f", 0.01) + _ticks(stamp)
    content += struct.pack("<fId?", 0.0, 0, 0.0, False)
    return _object("CObservation2DRangeScan", 7, content)


def _ticks(stamp: int) -> bytes:
    return struct.pack("<Q", stamp // (1_000_000_000 // TICKS_A_SECOND))


if __name__ == "__main__":
    main()
