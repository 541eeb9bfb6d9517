"""The projector without its shell: models and scans in; hypotheses, obstacles and advice out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from itertools import chain

import numpy as np
from eigenscan.eigenspace.analysis import Analysis, RegionSpace
from eigenscan.eigenspace.model import ModelError
from eigenscan.eigenspace.space_message import space_from_message
from eigenscan.geometry.gridmap import MapError
from eigenscan.geometry.normalize import FARTHEST_MOUNT
from eigenscan.geometry.pose import from_message
from eigenscan.projector.advice import Advisor
from eigenscan.projector.candidates import Fitted
from eigenscan.projector.channels import LOCALIZE_ANSWERED, LOCALIZE_ASKED, LOCALIZE_REFUSED
from eigenscan.projector.distinction import Lidar
from eigenscan.projector.focus import WHOLE, Focus, Scope
from eigenscan.projector.local import Asked, LocalSearch
from eigenscan.projector.model_set_assembler import ModelSetAssembler, WholeSet
from eigenscan.projector.observation import Observation, observe
from eigenscan.projector.one_shot import QueryError, answer
from eigenscan.projector.projection import Search, find_candidates, fit_around, look_also
from eigenscan.projector.publishing import hypotheses_message, local_message, obstacles_message, unusable
from eigenscan.projector.range_check import check, turn_of
from eigenscan.projector.set_aside import Sizes, size_of_space
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import SensorView, Site
from eigenscan.projector.tables import Store
from eigenscan.projector.waiting_scans import WaitingScans
from eigenscan.schemas import model_pb2
from eigenscan.schemas.advice_pb2 import Advice
from eigenscan.schemas.channels import (
    ADVICE,
    DEFAULT_ROBOT,
    HYPOTHESES,
    LIDAR_KIND,
    MAP,
    MODEL,
    MODEL_SET,
    OBSTACLES,
    POSE,
    SCAN,
    SEARCH,
    SPACE,
    TRACKS,
    Channel,
)
from eigenscan.schemas.envelope import Condition, Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import SearchRequest
from eigenscan.schemas.localize_pb2 import LocalizeQuery
from eigenscan.schemas.model_pb2 import LidarKind, ModelSet, RegionModel
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Tracks
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from google.protobuf.wrappers_pb2 import StringValue

ASK_AGAIN_NS = 10_000_000_000
"""Between two requests for a lidar's eigenspaces: a mapbuilder may have started since."""


class ProjectorCore:
    """Receives the site's models and its robots' scans; publishes the poses that explain each scan."""

    inputs: tuple[Channel, ...] = (MAP, MODEL, MODEL_SET, SPACE, SEARCH, SCAN, POSE, TRACKS)
    outputs: tuple[Channel, ...] = (HYPOTHESES, OBSTACLES, LIDAR_KIND, ADVICE)

    def __init__(
        self,
        settings: ProjectorSettings,
        instance: str = DEFAULT_ROBOT,
        store: Store | None = None,
        aside: Callable[[Callable[[], None]], None] | None = None,
        search: Search = find_candidates,
        whole_queries: bool = False,
    ) -> None:
        """`instance`: its name in the keys of its hypotheses, among the site's projectors.

        `store` keeps tables for the next start. `aside` runs work that no answer depends on, in a thread.
        `search`: how a scan is searched for; another may keep what it found.
        `whole_queries`: a query on {site}/localize waits for the whole site. Otherwise its answer may be
        about the regions that are ready, and states so.
        """
        self._settings, self._instance, self._search = settings, instance, search
        self._whole_queries = whole_queries
        self._store, self._aside = store, aside
        self._spaces: dict[tuple[str, Analysis], RegionSpace] = {}
        self._sizes: Sizes[tuple[str, Analysis]] = Sizes()
        self._asked: dict[tuple[str, str], int] = {}
        self._view: SensorView | None = None
        self._counts: Counter[str] = Counter()
        self.forget_robots()
        by_walls = settings.verification == settings.obstacles == "walls"
        self._fits_locally = by_walls and settings.share[1] == 1
        needed = {POSE: settings.focus, TRACKS: self._advisor.advises, SEARCH: self._fits_locally}
        self.inputs = tuple(one for one in ProjectorCore.inputs if needed.get(one, True))
        self._assembler = ModelSetAssembler()
        self._site: Site | None = None
        self._refused = ""

    def start(self) -> Iterable[Envelope]:
        """Publishes nothing before a scan."""
        return []

    def finish(self) -> Iterable[Envelope]:
        """The answers to scans that still wait for a request."""
        return self._answers(self._waiting.rest())

    def forget_robots(self) -> None:
        """Forgets what robots asked for and where they were; the map stays."""
        self._waiting = WaitingScans(self._counts, self._settings.request_within)
        self._forget_places()

    def _forget_places(self) -> None:
        self._focus, self._local, self._advisor = Focus(), LocalSearch(), Advisor(self._settings)

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """Takes a map, a model or a set; answers scans with hypotheses and obstacles, and queries."""
        if received.channel == SCAN:
            return self._answers(self._waiting.receive(_lidar_of(received.address), received))
        if received.channel == TRACKS:
            return self._advise(received)
        if received.channel == POSE:
            self._focus.receive(received.address["robot"], received.open(PoseEstimate))
        elif received.channel == SEARCH:
            request = received.open(SearchRequest)
            self._local.receive(_lidar_of(received.address), request)
            return self._answers(self._waiting.requested(_lidar_of(received.address), received.stamp))
        elif received.channel == MAP:
            self._take("map", lambda: self._assembler.put_map(received.open(Grid)))
        elif received.channel == MODEL:
            self._take("model", lambda: self._assembler.put_model(received.open(RegionModel)))
        elif received.channel == SPACE:
            self._take_space(received.open(model_pb2.RegionSpace))
        elif received.channel == LOCALIZE_ASKED:
            return [self._one_shot(received)]
        elif received.channel == MODEL_SET:
            self._take("model_set", lambda: self._assembler.put_set(received.open(ModelSet)))
        return []

    def _advise(self, received: Envelope) -> list[Envelope]:
        """What follows from a robot's tracks."""
        advice = self._advisor.receive(received.address["robot"], received.open(Tracks), self._site)
        if advice is None:
            return []
        self._counts["advised" if advice.kind == Advice.KIND_MOVE else "advised_nothing"] += 1
        return [Envelope(ADVICE, {**received.address, "projector": self._instance}, advice)]

    def condition(self) -> Condition:
        """WAITING without a model; DEGRADED if the newest one was refused."""
        counts = dict(self._counts) | dict(self._store.counts if self._store else {})
        if self._site is None:
            return Condition(Health.STATUS_WAITING, self._refused or self._assembler.missing, counts)
        detail = self._refused or self._assembler.missing or f"model {self._site.version[:12]}"
        status = Health.STATUS_DEGRADED if self._refused else Health.STATUS_OK
        if progress := self._progress():
            detail = f"{detail}; {progress}"
        return Condition(status, detail, counts)

    def _progress(self) -> str:
        """Progress of the work aside for the last lidar, as text; empty when it is done."""
        tables = self._view.tables if self._view and self._aside else None
        if tables is None or tables.made == len(tables.models):
            return ""
        return f"eigenspaces for this lidar: {tables.made} of {len(tables.models)} regions"

    def _take(self, kind: str, put: Callable[[], WholeSet | None]) -> None:
        try:
            whole = put()
            site = None if whole is None else Site(whole, self._settings, self._spaces, self._store)
        except (MapError, ModelError) as error:
            self._counts[f"refused_{kind}"] += 1
            self._refused = str(error)
            return
        self._counts[f"taken_{kind}"] += 1
        if self._assembler.set_aside:
            self._counts["set_aside_model"] = self._assembler.set_aside
        if site is not None:
            self._refused = ""
            before, self._site = self._site, site
            self._forget_places()
            held = {model.version for model in site.models}
            for key in [key for key in self._spaces if key[0] not in held]:
                del self._spaces[key]
                self._sizes.take(key)
            self._asked.clear()
            if before is not None:
                before.abandon()
                for sensor in before.sensors:
                    self._begin(site.view(sensor))
        elif kind == "model_set" and self._site is not None and self._assembler.is_whole(self._site.version):
            self._refused = ""  # the set in use is announced again; a part of the next one stays refused

    def _take_space(self, message: model_pb2.RegionSpace) -> None:
        """Takes a region's eigenspace for a kind of lidar."""
        try:
            own = space_from_message(message.space)
        except ValueError as error:
            self._counts["refused_space"] += 1
            self._refused = f"{_space_of(message)}{error}"
            return
        if self._refused.startswith(_space_of(message)):
            self._refused = ""
        self._counts["taken_space"] += 1
        new = message.model_version, own.analysis
        self._spaces[new] = own
        for key in self._sizes.put(new, size_of_space(own)):
            del self._spaces[key]
            self._counts["set_aside_space"] += 1

    def _begin(self, view: SensorView) -> None:
        """Starts the work aside for a new view."""
        if self._aside is not None:
            self._aside(view.tables.work_aside)

    def _ask(
        self, address: Mapping[str, str], scan: Scan, site: Site, view: SensorView
    ) -> Iterator[Envelope]:
        """Asks for the eigenspaces of a kind of lidar, now and then until they are there."""
        lidar, at = _lidar_of(address), nanoseconds(scan.timestamp)
        last = self._asked.get(lidar)
        if view.tables.is_known or (last is not None and 0 <= at - last < ASK_AGAIN_NS):
            return
        self._asked[lidar] = at
        analysis = view.tables.analysis
        kind = LidarKind(
            timestamp=scan.timestamp,
            beams=analysis.beams,
            cap=analysis.embedding.cap,
            model_version=site.version,
        )
        yield Envelope(LIDAR_KIND, address, kind)

    def _answers(self, scans: Iterable[Envelope]) -> Iterable[Envelope]:
        return chain.from_iterable([self._scan(scan) for scan in scans])

    def _scan(self, received: Envelope) -> Iterable[Envelope]:
        if self._site is None:
            self._counts["scan_without_model"] += 1
            self._waiting.has_no_list(_lidar_of(received.address))
            return []
        scan = received.open(Scan)
        address = {**received.address, "projector": self._instance}
        try:
            seen = observe(scan)
            mount = from_message(scan.mount)
            if not (np.abs(mount) <= FARTHEST_MOUNT).all():  # also where it is no number
                raise ValueError("the mount is farther than any robot is large")
        except ValueError:
            self._counts["scan_malformed"] += 1
            self._waiting.has_no_list(_lidar_of(received.address))
            return []
        self._advisor.see(received.address, nanoseconds(scan.timestamp), Lidar(seen.sensor, mount))
        if seen.measured < self._settings.least_beams:
            self._counts["scan_unusable"] += 1
            return [Envelope(HYPOTHESES, address, unusable(scan, self._site, seen))]
        self._counts["scan_projected"] += 1
        return self._answer(address, scan, seen, mount, self._site)

    def _one_shot(self, received: Envelope) -> Envelope:
        """The reply to a query, or the reason that there is none."""
        self._counts["queries"] += 1
        try:
            if self._site is None:
                raise QueryError(f"no answer yet: {self._refused or self._assembler.missing}")
            query = received.open(LocalizeQuery)
            reply = answer(query, self._site, self._settings, whole=self._whole_queries)
        except QueryError as error:
            self._counts["queries_refused"] += 1
            return Envelope(LOCALIZE_REFUSED, received.address, StringValue(value=str(error)))
        return Envelope(LOCALIZE_ANSWERED, received.address, reply)

    def _answer(
        self, address: dict[str, str], scan: Scan, seen: Observation, mount: np.ndarray, site: Site
    ) -> Iterator[Envelope]:
        """The hypotheses first: what comes after them is made when they are on their way."""
        is_new = not site.has_view(seen.sensor)
        view = self._view = site.view(seen.sensor)
        lidar, at = _lidar_of(address), nanoseconds(scan.timestamp)
        asked = self._local.asked(lidar, at, site.frame_id, scan.mount) if self._fits_locally else Asked()
        fitted = self._fitted(seen, site, asked)
        if fitted is not None and not is_new:
            yield Envelope(HYPOTHESES, address, local_message(scan, site, seen, mount, fitted))
            yield Envelope(OBSTACLES, address, obstacles_message(scan, site, seen, mount, fitted.pose))
            return
        scope = self._scope(address, scan, site)
        candidates = self._search(site, view, seen, self._settings, scope=scope)
        if len(asked.places) and scope.regions is None and candidates.waiting is None:
            candidates = look_also(site, seen, candidates, asked.places, self._settings.published)
        if scope.regions is None:
            self._focus.searched_whole(*lidar, at, candidates.ordinary)
            self._local.searched_whole(lidar, at, candidates.ordinary)
        message = hypotheses_message(scan, site, seen, mount, candidates, scope)
        if self._settings.verification == "walls":
            again = scope.regions is None and candidates.waiting is None
            search = (
                partial(self._search, site, view, settings=self._settings, scope=WHOLE) if again else None
            )
            checked = check(site, seen, candidates, search, turn_of(at))
            if checked is not None:
                message.range_check.CopyFrom(checked)
        yield Envelope(HYPOTHESES, address, message)
        if len(candidates.poses):
            best = candidates.poses[0]
            yield Envelope(OBSTACLES, address, obstacles_message(scan, site, seen, mount, best, candidates))
        yield from self._ask(address, scan, site, view)
        if is_new:
            self._begin(view)

    def _fitted(self, seen: Observation, site: Site, asked: Asked) -> Fitted | None:
        """The scan's pose around the one that the tracker predicts; None: search the whole map."""
        around = asked.around
        if around is None:
            return None
        fitted = fit_around(site, seen, around.starts, around.ordinary)
        if not around.holds(fitted):
            self._counts["local_fit_lost"] += 1
            return None
        self._counts["scan_fitted_locally"] += 1
        return fitted

    def _scope(self, address: dict[str, str], scan: Scan, site: Site) -> Scope:
        """The regions to search: all, unless the tracker is sure and all were searched lately."""
        if not self._settings.focus:
            return WHOLE
        robot, lidar = _lidar_of(address)
        reach = self._focus.reach(robot, lidar, nanoseconds(scan.timestamp), site.frame_id)
        near = reach.regions(site.boxes) if reach else np.zeros(0, dtype=bool)
        if not near.any():
            return WHOLE
        self._counts["scan_focused"] += 1
        return Scope(near, self._focus.ordinary(robot, lidar))


def _space_of(message: model_pb2.RegionSpace) -> str:
    return f"region {message.region!r}: space: "


def _lidar_of(address: Mapping[str, str]) -> tuple[str, str]:
    return address["robot"], address["lidar"]
