"""Makes the README's moving picture of a real log: lost, candidates, found, kidnapped, found again.

    .venv/bin/python tools/film.py ../shared/datasets/intel docs/images/found.gif

The real cores run over two stretches of the log, joined by a kidnap as in `eigenscan evaluate --kidnap`. The
folder holds map.yaml, log.clf.gz and its reference log.tum; stretches are in s, by the log's stamps.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import compose, from_message, transform
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.recorder.picture.palette import HYPOTHESIS, SCAN, STATE_COLOURS, Colour, state_name
from eigenscan.schemas import hypotheses_pb2, scan_pb2
from eigenscan.schemas.channels import HYPOTHESES, POSE, TRACKS
from eigenscan.schemas.channels import SCAN as SCANS
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, PoseEstimate, State, Tracks
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.evaluation.kidnap import Splice, splice
from eigenscan.workbench.evaluation.log import read_log
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.reference import Trajectory, read_trajectory
from eigenscan.workbench.evaluation.windows import Window
from eigenscan.workbench.logs import LogOptions
from numpy.typing import NDArray
from PIL import Image

mpl.use("Agg")
from matplotlib import pyplot as plt

NS = 1_000_000_000
SHOWN = 0.01
"""Probability from which a track is drawn."""

LISTED = 12
"""Hypotheses of the newest scan that are drawn while nothing is claimed."""

SPEED = 2.5
READ_FIRST = re.compile("Found|Kidnapped")
READ_S, LAST_S = 1.2, 3.0
"""A frame that begins such a caption, and the last one, stand so long."""

CREDIT = "Intel Research Lab (D. Hähnel, CC BY 3.0)"

NO_MAP, FLOOR, WALL = 0.90, 1.0, 0.2
EDGE = 0.004
"""Share of the free cells that is cut off on each side."""


@dataclass(frozen=True)
class Moment:
    """One scan's answer: s since the start, state, tracks (n, 3), weights, hypotheses (m, 3), pose."""

    time_s: float
    state: State
    tracks: NDArray[np.float64]
    weights: NDArray[np.float64]
    hypotheses: NDArray[np.float64]
    pose: NDArray[np.float64]
    points: NDArray[np.float64]
    error_m: float
    caption: str = ""


def moments(folder: Path, before: Window, after: Window) -> tuple[GridMap, list[Moment]]:
    """The pipeline's answers over both stretches, and the map."""
    log = read_log(folder / "log.clf.gz", LogOptions(), lambda _: None)
    reference = read_trajectory(folder / "log.tum", 0.0)
    built = build(folder / "map.yaml", MapbuilderSettings(), lambda _: None)
    projector, tracker = ProjectorCore(ProjectorSettings()), TrackerCore(TrackerSettings())
    for core in (projector, tracker):
        for model in built.models:
            if model.channel in core.inputs:
                list(core.handle(model))
    loop = Loopback([ScanIngestCore(ScanIngestSettings()), projector, tracker])
    loop.start()
    joined = splice(log.between(before), log.between(after))
    found = list(_run(loop, joined, reference))
    return built.site.grid, _captioned(found, (joined.jump - before.start) / NS)


def _run(loop: Loopback, joined: Splice, reference: Trajectory) -> Iterator[Moment]:
    start, scans = joined.received[0].stamp, dict[int, NDArray[np.float64]]()
    tracks, hypotheses = Tracks(), np.zeros((0, 3))
    for envelope in joined.received:
        for answer in loop.receive(envelope):
            if answer.channel == SCANS:
                scans[answer.stamp] = _points(answer.open(scan_pb2.Scan))
            elif answer.channel == HYPOTHESES:
                several = answer.open(hypotheses_pb2.Hypotheses).hypotheses[:LISTED]
                hypotheses = np.array([from_message(each.pose) for each in several]).reshape(-1, 3)
            elif answer.channel == TRACKS:
                tracks = answer.open(Tracks)
            elif answer.channel == POSE:
                estimate, stamp = answer.open(PoseEstimate), answer.stamp
                pose = from_message(estimate.pose)
                logged = stamp - (joined.moved if stamp >= joined.jump else 0)
                true = reference.at([logged])[0][0]
                listed = [each for each in tracks.tracks if each.probability >= SHOWN]
                yield Moment(
                    time_s=(stamp - start) / NS,
                    state=estimate.state,
                    tracks=np.array([from_message(each.pose) for each in listed]).reshape(-1, 3),
                    weights=np.array([each.probability for each in listed]),
                    hypotheses=hypotheses,
                    pose=pose,
                    points=transform(pose, scans.get(stamp, np.zeros((0, 2)))),
                    error_m=float(np.hypot(*(pose - true)[:2])),
                )


def _points(scan: scan_pb2.Scan) -> NDArray[np.float64]:
    """End points (n, 2) of a scan in the robot's base frame, m."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    seen = np.isfinite(ranges)
    points = ranges[seen, None] * np.stack([np.cos(angles[seen]), np.sin(angles[seen])], axis=1)
    return transform(compose(np.zeros(3), from_message(scan.mount)), points)


def _captioned(found: list[Moment], jump_s: float) -> list[Moment]:
    """The same with a line each that states what happens."""
    captioned, since, text = [], 0.0, ""
    for before, moment in zip([None, *found], found, strict=False):
        if before is not None and before.time_s < jump_s <= moment.time_s:
            since, text = jump_s, "Kidnapped: carried to another room without notice"
        claimed = moment.state == STATE_LOCALIZED
        if claimed and (before is None or before.state != STATE_LOCALIZED):
            again = " again" if since else ""
            centimetres = 100 * moment.error_m
            text = (
                f"Found{again} after {moment.time_s - since:.1f} s, {centimetres:.0f} cm from the reference"
            )
        elif not claimed and since and moment.time_s - since > 1.0:
            text = "Searching the whole map"
        elif not claimed and not since:
            if moment.state == STATE_AMBIGUOUS:
                text = "A few candidates are left"
            elif not text:
                text = "No initial pose, many candidates"
        captioned.append(replace(moment, caption=text))
    return captioned


def draw(grid: GridMap, found: list[Moment]) -> list[Image.Image]:
    """A frame for each moment."""
    figure, axes = plt.subplots(figsize=(7.2, 7.0), dpi=100)
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=0.915)
    _draw_map(grid, axes)
    banner = figure.text(0.02, 0.945, "", fontsize=17, weight="bold")
    caption = figure.text(0.27, 0.947, "", fontsize=13, color="#202020")
    frames, drawn = [], list[mpl.artist.Artist]()
    for moment in found:
        while drawn:
            drawn.pop().remove()
        claimed, colour = moment.state == STATE_LOCALIZED, _rgb(STATE_COLOURS[moment.state])
        banner.set_text(state_name(moment.state))
        banner.set_color(colour)
        caption.set_text(moment.caption)
        if claimed:
            drawn.append(
                axes.scatter(moment.points[:, 0], moment.points[:, 1], s=5, color=_rgb(SCAN), zorder=3)
            )
            drawn.append(_arrows(axes, moment.pose[None], colour, np.ones(1), 2.4))
        else:
            if len(moment.hypotheses):
                drawn.append(
                    _arrows(axes, moment.hypotheses, "#b0b0b0", np.ones(len(moment.hypotheses)), 1.3)
                )
            if len(moment.tracks):
                alpha = 0.3 + 0.7 * np.sqrt(moment.weights / moment.weights.max())
                drawn.append(_arrows(axes, moment.tracks, _rgb(HYPOTHESIS), alpha, 1.9))
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]
        frames.append(Image.fromarray(pixels.copy()))
    return frames


def _draw_map(grid: GridMap, axes: mpl.axes.Axes) -> None:
    grey = np.full(grid.cells.shape, NO_MAP)
    grey[grid.cells == FREE], grey[grid.cells == OCCUPIED] = FLOOR, WALL
    height, width = grid.cells.shape
    x, y, _ = grid.origin
    extent = (x, x + width * grid.resolution, y, y + height * grid.resolution)
    axes.imshow(grey, "gray", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="antialiased")
    rows, columns = np.nonzero(grid.cells == FREE)
    # a few rays that left through a window are no building
    low = grid.to_map(np.array([np.quantile(columns, EDGE), np.quantile(rows, EDGE)])) - 1.2
    high = grid.to_map(np.array([np.quantile(columns, 1 - EDGE), np.quantile(rows, 1 - EDGE)])) + 1.2
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.axis("off")
    axes.plot([low[0] + 0.5, low[0] + 5.5], [low[1] + 0.5] * 2, color="#202020", lw=3, solid_capstyle="butt")
    paper = {"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.5}
    axes.text(low[0] + 3.0, low[1] + 0.9, "5 m", ha="center", fontsize=11, color="#202020", bbox=paper)
    credit = f"{CREDIT}, {SPEED:g} times real time"
    axes.text(high[0] - 0.4, low[1] + 0.4, credit, ha="right", fontsize=9, color="#404040", bbox=paper)


def _arrows(
    axes: mpl.axes.Axes, poses: NDArray[np.float64], colour: str, alpha: NDArray[np.float64], size: float
) -> mpl.artist.Artist:
    x, y, heading = poses.T
    colours = [(*mpl.colors.to_rgb(colour), float(each)) for each in alpha]
    return axes.quiver(
        *(x, y, np.cos(heading), np.sin(heading)),
        color=colours, zorder=4, angles="xy", scale_units="xy", scale=1 / size,
        units="xy", width=0.28, headwidth=3.6, headlength=3.6, headaxislength=3.2, pivot="mid",
    )  # fmt: skip


def _rgb(colour: Colour) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def save(frames: list[Image.Image], found: list[Moment], path: Path) -> None:
    """An animated GIF, `SPEED` times as fast as the log, with one palette for all frames."""
    step = max(1, len(frames) // 12)
    # the colours that mean something are few pixels: without a patch of each they would be mixed
    colours = [*STATE_COLOURS.values(), SCAN, HYPOTHESIS]
    patch = np.repeat(np.array(colours, np.uint8), 4000, axis=0).reshape(-1, frames[0].width // 9, 3)
    patch = np.tile(patch, (1, 9, 1))
    sample = Image.fromarray(np.vstack([patch, *(np.asarray(frame) for frame in frames[::step])]))
    palette = sample.quantize(96, dither=Image.Dither.NONE)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    times = [moment.time_s for moment in found]
    # a GIF counts hundredths of a second
    lasts = [max(20, 10 * round(100 * (b - a) / SPEED)) for a, b in pairwise(times)]
    for number, (before, moment) in enumerate(pairwise(found[:-1]), 1):
        if moment.caption != before.caption and READ_FIRST.search(moment.caption):
            lasts[number] = round(READ_S * 1000)
    small[0].save(
        path,
        save_all=True,
        append_images=small[1:],
        duration=[*lasts, round(LAST_S * 1000)],
        loop=0,
        optimize=True,
    )


def main() -> None:
    """Makes the film that the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--before", type=float, nargs=2, default=(1000001650.55, 1000001668.05))
    parser.add_argument("--after", type=float, nargs=2, default=(1000002435.49, 1000002453.0))
    parser.add_argument("--frames", type=Path, help="folder for every tenth frame as PNG, to look at")
    given = parser.parse_args()
    windows = [Window(round(a * NS), round(b * NS)) for a, b in (given.before, given.after)]
    grid, found = moments(given.folder, *windows)
    frames = draw(grid, found)
    save(frames, found, given.out)
    if given.frames:
        given.frames.mkdir(parents=True, exist_ok=True)
        for number in range(0, len(frames), 10):
            frames[number].save(given.frames / f"{number:03}.png")
    print(f"{given.out}: {len(frames)} frames, {given.out.stat().st_size / 1e6:.2f} MB")
    for text in dict.fromkeys(moment.caption for moment in found):
        print(f"  {text}")


if __name__ == "__main__":
    main()
