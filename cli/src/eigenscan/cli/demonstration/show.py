"""The demo itself: a robot, all services, and a judgement at the end."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import NoReturn
from urllib.parse import parse_qs, urlsplit

import psutil
import zenoh
from eigenscan.cli.entry import ENDING, SIGNALLED
from eigenscan.cli.launch.network import open_hub
from eigenscan.cli.launch.screen import StatusLine, error_text
from eigenscan.cli.launch.services import Pipeline, viewer_link, wait_until_ready
from eigenscan.cli.launch.supervision import Supervisor
from eigenscan.fleet.view import FleetView
from eigenscan.geometry.gridmap import write_map
from eigenscan.geometry.pose import from_message
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.errors import StoppedError
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.stop_event import StopEvent
from eigenscan.schemas.channels import IN_PLAY, TRACKS
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Tracks
from eigenscan.schemas.wire import decode
from eigenscan.schemas.words import state_word
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.recorded import Recorded
from eigenscan.workbench.simulation.stage import Stage
from eigenscan.workbench.simulation.verdict import ENOUGH, Sighting, Stretch, judge

EARLY = "before the robot was found again"
OPEN_S = 30.0
"""Time that the robot waits for a visitor to open the viewer, s."""
LOADED_S = 4.0
"""Time that a browser takes from the connection to the first picture, s."""
AT_ONCE_S = 0.15
"""A kidnap that the next scan shows is noticed at once."""
LAST_WORDS_S = 5.0
"""Time for the pipeline to answer the last scan, s."""


class Demonstration:
    """One run of the demo; all its files go to `folder`.

    `figures`: results before and after the kidnap, after the end.
    """

    def __init__(
        self,
        stage: Stage | Recorded,
        folder: Path,
        speed: float,
        viewer: bool,
        to_stderr: bool = False,
    ) -> None:
        self._stage = stage
        self._folder, self._speed, self._viewer = folder, speed, viewer
        self._stop = StopEvent()
        self._line = StatusLine(to_stderr)
        self.figures: dict[str, object] = {}
        self._shown: int | None = None
        self._carried = False
        self._tracks = Inbox()
        self._candidates: dict[float, int] = {}

    def run(self) -> bool:
        """Runs to the end; True if the robot was found, and found again after the kidnap.

        Raises FailedError if a service dies or does not get ready, StoppedError if it is ended before.
        """
        scenario, folder = self._stage.scenario, self._folder
        with ExitStack() as stack:
            stack.enter_context(self._stop.on_signals())
            stack.enter_context(self._line)
            session, zenoh = open_hub(folder)
            view = stack.enter_context(FleetView(session, scenario.site))
            # declared before anybody listens: so this end knows of every listener by the first message
            for key in self._stage.keys:
                stack.enter_context(session.declare_publisher(key))
            supervisor = stack.enter_context(Supervisor(folder / "logs"))
            map_file = folder / "map.yaml"
            write_map(self._stage.grid, map_file)
            pipeline = Pipeline(
                site=scenario.site,
                robot=scenario.robot,
                model_flags=["--map", str(map_file)],
                zenoh=zenoh,
                mcap=folder / "demo.mcap",
                rrd=folder / "demo.rrd",
                viewer=self._viewer,
            )
            pipeline.start(supervisor)
            if not wait_until_ready(supervisor, pipeline.services, view, self._line, self._stop):
                self._end_early()
            stack.callback(self._bus_of(session).close)
            if link := viewer_link(supervisor):
                self._line.keep(f"watch it here: {link}")
                self._wait_for_viewer(supervisor, link)
            sightings = self._play(view, supervisor)
            if self._stop.stopping:
                self._end_early()
            supervisor.stop(keep=["recorder"] if self._viewer else [])
            found = self._conclude(sightings)
            if self._viewer:
                self._stay(supervisor)
            return found

    def _end_early(self) -> NoReturn:
        """Raises what the signal that ended it stands for."""
        if self._stop.number in ENDING:
            raise SystemExit(SIGNALLED + self._stop.number)
        raise StoppedError(EARLY)

    def _bus_of(self, session: zenoh.Session) -> Bus:
        """A bus whose inbox receives the tracks."""
        bus = Bus(session)
        bus.listen([TRACKS], {"site": self._stage.scenario.site}, self._tracks)
        return bus

    def _wait_for_viewer(self, supervisor: Supervisor, link: str) -> None:
        """Returns once a browser shows the viewer, or after OPEN_S."""
        recorder = psutil.Process(supervisor.children["recorder"].process.pid)
        port, deadline = data_port(link), time.monotonic() + OPEN_S
        self._line.keep(f"open it now: the robot starts when it is open, or in {OPEN_S:.0f} s")
        while not self._stop.stopping and time.monotonic() < deadline:
            supervisor.check()
            if is_watched(recorder, port):
                self._stop.wait(LOADED_S)
                return
            self._stop.wait(0.2)

    def _count_candidates(self) -> None:
        """Takes in the tracks that came."""
        while (arrival := self._tracks.take(0.0)) is not None:
            message = decode(arrival.channel, arrival.payload)
            if isinstance(message, Tracks):
                number = sum(track.probability >= IN_PLAY for track in message.tracks)
                self._candidates[self._time(nanoseconds(message.timestamp))] = number

    def _play(self, view: FleetView, supervisor: Supervisor) -> list[Sighting]:
        """Publishes the simulation and receives the poses, until both are through."""
        stage = self._stage
        sightings: list[Sighting] = []
        stop = threading.Event()
        stage.epoch = time.time_ns()
        last_scan = self._time(int(stage.times[stage.scan_ticks[-1]]))
        with ThreadPoolExecutor(1, "simulation") as pool:
            robot = pool.submit(publish, stage.messages(), view.publish, self._speed, stop)
            patience = time.monotonic() + stage.scenario.seconds / self._speed + LAST_WORDS_S
            try:
                while not self._stop.stopping:
                    supervisor.check()
                    self._count_candidates()
                    for estimate in view.update():
                        sightings.append(self._sighting(estimate))
                        self._report(estimate.state, sightings[-1])
                    if robot.done():
                        robot.result()
                        answered = sightings and sightings[-1].time >= last_scan - 1e-6
                        if answered or time.monotonic() > patience:
                            break
                    else:
                        patience = time.monotonic() + LAST_WORDS_S
                    self._stop.wait(0.1)
            finally:
                stop.set()
        return sightings

    def _time(self, stamp: int) -> float:
        """Seconds since the first scan."""
        stage = self._stage
        return (stamp - int(stage.times[stage.scan_ticks[0]])) * 1e-9

    def _sighting(self, estimate: PoseEstimate) -> Sighting:
        stamp = nanoseconds(estimate.timestamp)
        return Sighting(
            time=self._time(stamp),
            pose=from_message(estimate.pose),
            truth=self._stage.pose_at(stamp),
            claimed=estimate.state == STATE_LOCALIZED,
            confidence=estimate.confidence,
        )

    @property
    def _kidnap(self) -> float:
        """When the robot is kidnapped, s since the first scan."""
        stage = self._stage
        return stage.scenario.seconds if stage.kidnap_time is None else self._time(stage.kidnap_time)

    def _report(self, state: int, seen: Sighting) -> None:
        if seen.time >= self._kidnap and not self._carried:
            self._carried = True
            self._line.keep(
                f"{self._kidnap:5.1f} s  kidnapped: carried to another room, its wheels do not turn"
            )
        error = f"  error {error_text(seen.error_m, seen.error_rad)}" if seen.claimed else ""
        text = f"{seen.time:5.1f} s  {state_word(state):<9}  confidence {seen.confidence:.2f}{error}"
        if state != self._shown:
            self._shown = state
            self._line.keep_own(text)
        self._line.show(text)

    def _conclude(self, sightings: list[Sighting]) -> bool:
        """Prints the summary."""
        self._count_candidates()
        sightings = [replace(each, candidates=self._candidates.get(each.time, 0)) for each in sightings]
        before = judge(sightings, 0.0, self._kidnap)
        after = judge(sightings, self._kidnap, self._stage.scenario.seconds)
        files = [path for path in sorted(self._folder.iterdir()) if not path.name.startswith("zenoh")]
        self._line.keep_own(summarize(before, after, self._kidnap, files))
        found = before.found and after.found
        self.figures = {"found": found, "before": before.figures, "after": after.figures}
        return found

    def _stay(self, supervisor: Supervisor) -> None:
        self._line.keep("the viewer stays until Ctrl-C")
        while not self._stop.stopping:
            supervisor.check()
            self._stop.wait(1.0)


def data_port(link: str) -> int:
    """The port that the viewer behind `link` takes its data from."""
    source = parse_qs(urlsplit(link).query)["url"][0]
    return urlsplit(source.removeprefix("rerun+")).port or 0


def is_watched(process: psutil.Process, port: int) -> bool:
    """Whether a client is connected to `port` of `process`."""
    connections = process.net_connections("tcp")
    return any(each.status == psutil.CONN_ESTABLISHED and each.laddr.port == port for each in connections)


def summarize(before: Stretch, after: Stretch, kidnap: float, files: Sequence[Path]) -> str:
    """Text over the stretches before and after the kidnap at `kidnap` s, and the files written."""
    rows = [
        ("start", _search(before)),
        ("then", _accuracy(before)),
        (f"kidnap at {kidnap:.0f} s", f"{_noticed(after)}; {_search(after)}"),
        ("then", _accuracy(after)),
        ("claims", f"{before.claims + after.claims}, {before.wrong_claims + after.wrong_claims} wrong"),
    ]
    rows += [("files" if not number else "", _file(path)) for number, path in enumerate(files)]
    lines = [f"  {name:<16}{text}" for name, text in rows]
    return "\n".join(["", _headline(before, after), *lines])


def _headline(before: Stretch, after: Stretch) -> str:
    if before.found and after.found:
        return "The robot found itself, was carried to another room, and found itself again."
    if not before.found:
        return f"FAILED: the robot did not find itself before the kidnap ({_why(before)})."
    return f"FAILED: the robot did not find itself again after the kidnap ({_why(after)})."


def _why(stretch: Stretch) -> str:
    if not stretch.claims:
        return "it claimed no pose"
    if stretch.wrong_claims == stretch.claims:
        return f"all {stretch.claims} poses that it claimed were wrong"
    wrong = f"{stretch.wrong_claims} of {stretch.claims} claimed poses were wrong"
    return f"{wrong}, and no {ENOUGH} right ones in a row lasted to the end"


def _search(stretch: Stretch) -> str:
    if stretch.found_after is None:
        return "never found"
    if stretch.scans <= 1:
        return "found with the first scan"
    return (
        f"lost for {stretch.found_after:.1f} s, {stretch.candidates} candidates, "
        f"found after {stretch.scans} scans"
    )


def _noticed(stretch: Stretch) -> str:
    if stretch.noticed_after is None:
        return "not noticed"
    if stretch.noticed_after < AT_ONCE_S:
        return "noticed at once"
    return f"noticed after {stretch.noticed_after:.1f} s"


def _accuracy(stretch: Stretch) -> str:
    if not stretch.found:
        return "-"
    error = error_text(stretch.error_m, stretch.error_rad)
    return f"error {error} (median), confidence {stretch.confidence:.2f}"


def _file(path: Path) -> str:
    if path.is_dir():
        return f"{path}/"
    return f"{path}  ({path.stat().st_size / 1e6:.1f} MB)"
