"""The cores behind one small object."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from eigenscan.eigenspace.floors import floor_of
from eigenscan.eigenspace.folder import SiteModel, read_models
from eigenscan.eigenspace.model import ModelError
from eigenscan.geometry.gridmap import GridMap, MapError, check_grid, to_message
from eigenscan.geometry.plans import PlanOptions, read_plan
from eigenscan.geometry.pose import to_message as pose_message
from eigenscan.localize.answers import Estimate, Hypotheses
from eigenscan.localize.scan import Scan, is_number
from eigenscan.localize.session import Session
from eigenscan.mapbuilder.core import announce_models
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import build_site
from eigenscan.projector.channels import LOCALIZE_ASKED, LOCALIZE_REFUSED
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.schemas.channels import DEFAULT_SITE, MAP
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.extra import needs
from eigenscan.schemas.localize_pb2 import LocalizeQuery, LocalizeReply
from eigenscan.schemas.methods import of_service
from google.protobuf.wrappers_pb2 import StringValue
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LOGS = (".mcap", ".bag", ".clf", ".csv", ".db3")
"""Ends of the names of logs, which people give for the map."""


class Localizer:
    """Localizes scans in one map: each alone (`localize`), or with all scans before it (`track`).

    Use it from one thread at a time. One object serves lidars of any kind, but tracks one robot. A copy, such
    as in another process, has the models and no tracks.
    """

    def __init__(self, site: SiteModel, method: str = "default") -> None:
        """Makes a localizer of models; for a map see `from_map` and `from_grid`.

        `method`: "default", or "paper" for the paper's own pipeline, which needs eigenscan-localize[paper] to
        track. Raises ValueError for an unknown method, and ModelError if it needs other models.
        """
        if not isinstance(site, SiteModel):
            fix = (
                "Localizer.from_grid(grid)" if isinstance(site, GridMap) else 'Localizer.from_map("map.yaml")'
            )
            raise TypeError(f"{site!r:.80} is no SiteModel: of a map write {fix}")
        site.check_method(method)
        self.site = site
        self._method = method
        settings = ProjectorSettings.model_validate({"advice": False} | of_service(method, "projector"))
        self._projector = ProjectorCore(settings, whole_queries=True)
        self._projector_receives(site)
        self._session: Session | None = None

    def __reduce__(self) -> tuple[type[Localizer], tuple[SiteModel, str]]:
        return type(self), (self.site, self._method)

    def __repr__(self) -> str:
        regions, grid = self.site.regions, self.site.grid
        positions = sum(len(model.index) for model in regions)
        return (
            f"<Localizer: {grid.free_area:.0f} m2 in {len(regions)} regions of {positions} positions, "
            f"version {self.site.to_message().version[:12]}>"
        )

    @classmethod
    def from_map(
        cls,
        path: str | os.PathLike[str],
        metres_per_unit: float | None = None,
        layers: Collection[str] = (),
        method: str = "default",
    ) -> Localizer:
        """Makes a localizer of a map, whose models are built now, or of a model folder.

        A map is a map_server yaml, an image (black wall, white floor, grey unknown; give `metres_per_unit`, m
        a pixel), or a floor plan, DXF or SVG, whose walls are on `layers`. Raises MapError or ModelError,
        both ValueError, that name the file, the field and the fix.
        """
        place = Path(path)
        if metres_per_unit is not None:
            _be_a_number(metres_per_unit, "metres_per_unit", "m")
        if not str(path) or place.suffix.lower() in _LOGS:
            what = "is a log, no map" if str(path) else "the path is empty"
            raise MapError(f"{path or repr(path)}: {what}: give a map or a model folder")
        if place.is_dir():
            return cls(read_models(place), method)
        try:
            grid = read_plan(place, PlanOptions(metres_per_unit, layers))
        except MapError as error:  # which names the command line's options
            words = str(error).replace("--metres-per-unit", "metres_per_unit").replace("--layer", "layers")
            raise MapError(words) from error
        try:
            return cls.from_grid(grid, method)
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error

    @classmethod
    def from_grid(cls, grid: GridMap, method: str = "default") -> Localizer:
        """Makes a localizer of a grid in memory.

        Raises MapError for what is no grid, and ModelError if no place in it is free.
        """
        check_grid(grid)
        plan = MapbuilderSettings.model_validate(of_service(method, "mapbuilder")).plan
        return cls(build_site(grid, replace(plan, threads=os.cpu_count() or 1)), method)

    def localize(
        self,
        scan: Scan,
        near: ArrayLike | None = None,
        radius: float = 0.0,
        turn: float = 0.0,
        floor: str = "",
        region: str = "",
    ) -> Hypotheses:
        """Finds where `scan` may have been taken, from this scan alone, as a query on {site}/localize does.

        Searches the whole map: the first scan of a kind of lidar takes longer, on a large map up to a minute.
        Searches only within `radius`, m, of the pose `near` (3,), m, m, rad in the map frame, with a heading
        within `turn`, rad, of its own (0: any heading); only on `floor` (then `near` is in that floor's
        frame); only in `region`. Raises ScanError for a scan that cannot be used, and ValueError that names
        another bad argument.
        """
        _be_a_scan(scan)
        _be_a_number(radius, "radius", "m")
        _be_a_number(turn, "turn", "rad")
        _be_a_name(floor, "floor")
        _be_a_name(region, "region")
        scan.canonical()
        asked = LocalizeQuery(scan=scan.raw(), radius=radius, turn=turn, floor=floor, region=region)
        if near is not None:
            asked.near.CopyFrom(pose_message(_pose(near, "near")))
        (published,) = self._projector.handle(Envelope(LOCALIZE_ASKED, {"query": "1"}, asked))
        if published.channel is LOCALIZE_REFUSED:
            raise ValueError(published.open(StringValue).value)
        return Hypotheses.of(published.open(LocalizeReply), scan)

    def track(self, scan: Scan, odometry: ArrayLike | None = None) -> Estimate:
        """Tracks the robot with one more scan; `scan.time` must increase, or be the same for another lidar.

        `odometry` (3,): the base in the odometry's own frame at the scan's time, m, m, rad. Without it, the
        robot may have moved anywhere within its greatest speed. Raises ScanError for a scan that cannot be
        used.
        """
        _be_a_scan(scan)
        pose = None if odometry is None else _pose(odometry, "odometry")
        self._session = self._session or Session(self._method, self.site, self._projector)
        return Estimate.of(self._session.track(scan, pose))

    def floor(self, pose: ArrayLike) -> tuple[str, NDArray[np.float64]] | None:
        """The floor of a pose (3,): its name, and the pose in that floor's own map frame.

        None if the models have no floors, or the pose is on none. Raises ValueError for what is no pose.
        """
        at = _pose(pose, "pose")
        found = floor_of(self.site.floors, at)
        return None if found is None else (found.name, found.own(at))

    def forget(self) -> None:
        """Forgets all tracks."""
        self._session = None

    def plot(self, found: Hypotheses | None = None, axes: Axes | None = None) -> Axes:
        """Draws the map and `found`. Needs matplotlib: pip install 'eigenscan-localize[plot]'."""
        if not (found is None or isinstance(found, Hypotheses)):
            raise TypeError(f"{type(found).__name__} is no Hypotheses: give what localize answers")
        with needs("eigenscan-localize[plot]"):
            from eigenscan.localize.drawing import draw

        return draw(self.site.grid, found, axes)

    def _projector_receives(self, site: SiteModel) -> None:
        grid = Envelope(MAP, {"site": DEFAULT_SITE}, to_message(site.grid, site.frame_id))
        for published in (grid, *announce_models(site, DEFAULT_SITE)):
            list(self._projector.handle(published))


def _be_a_scan(scan: Scan) -> None:
    """Raises TypeError for ranges without their angles, and all else that is no scan."""
    if not isinstance(scan, Scan):
        raise TypeError(
            f"{type(scan).__name__} is no Scan: give Scan(ranges, angle_min, angle_increment, range_max), "
            "m and rad"
        )


def _be_a_number(given: object, name: str, unit: str) -> None:
    """Raises TypeError that names the argument."""
    if not is_number(given):
        raise TypeError(f"{name} = {given!r:.80}: give a number, {unit}")


def _be_a_name(given: object, name: str) -> None:
    """Raises TypeError that names the argument."""
    if not isinstance(given, str):
        raise TypeError(f"{name} = {given!r:.80}: give its name, a str")


def _pose(given: ArrayLike, name: str) -> NDArray[np.float64]:
    """Checks a pose (3,). Raises ValueError."""
    try:
        pose = np.asarray(given, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} = {given!r:.80}: give x, y and heading (3,), m, m, rad") from None
    if pose.shape != (3,):
        raise ValueError(f"{name} of shape {pose.shape}: give x, y and heading (3,), m, m, rad")
    if not np.isfinite(pose).all():
        raise ValueError(f"{name} = {pose.tolist()}: must be finite: leave out what is not known")
    return pose
