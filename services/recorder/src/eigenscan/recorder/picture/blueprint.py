"""The layouts: a bar with the state, and below it the panels for each reader."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from eigenscan.recorder.picture.canvas import TIMELINE
from eigenscan.recorder.picture.curves import BOUNDS
from eigenscan.recorder.picture.layout import Layout
from numpy.typing import ArrayLike

FIELD_OF_VIEW = np.deg2rad(55.0)
"""Vertical field of view of the viewer's camera."""
UNKNOWN_FLOOR = [112, 137, 134]
"""Colour of unknown space in the map's texture."""
ROOM_AHEAD = 0.06
"""Space of a plot right of the newest value, as a share of its span: an axis cuts text at its end."""
MARGIN = 1.14
"""Factor from the map to the visible area: the scale bar is below the map."""
ASPECT = 1.35
"""Width over height of the map's panel on a usual screen."""


Past = Sequence[rr.VisibleTimeRange] | None
Extent = tuple[ArrayLike, ArrayLike]


def blueprint(
    layout: Layout,
    extent: Extent | None,
    window_s: float | None,
    live: bool,
    draw_all: bool = False,
    has_truth: bool = False,
) -> rrb.Blueprint:
    """Panels for any number of robots.

    `extent`: low and high corner of the visible map, m. `window_s`: time span of plots, s, None for all.
    `live`: follows the newest time. `draw_all`: raw scans and frames as well. `has_truth`: there are errors
    to show.
    """
    panels = {"operator": _operator, "developer": _developer, "researcher": _researcher, "fleet": _fleet}
    shown = panels[layout](extent, _past(window_s), has_truth)
    if draw_all:
        shown = rrb.Tabs(shown, rrb.Horizontal(_raw(), _frames(), name="Raw scans, frames"), active_tab=0)
    return rrb.Blueprint(
        shown,
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="following" if live else "playing",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _operator(extent: Extent | None, past: Past, has_truth: bool) -> rrb.Container:
    """Where is the robot, and is it sure?"""
    errors = [rrb.Tabs(*_errors(past))] if has_truth else []
    evidence = rrb.Vertical(
        _state(past),
        _belief(past),
        *errors,
        rrb.Tabs(_legend(), _beams(), _eigenspace(), _events()),
        row_shares=[1.2, 2, *(2 for _ in errors), 5],
    )
    return _under_the_bar(rrb.Horizontal(_map(extent), evidence, column_shares=[7, 4]))


def _developer(extent: Extent | None, past: Past, has_truth: bool) -> rrb.Container:
    """Which service did what, when?"""
    curves = rrb.Vertical(
        _state(past),
        _belief(past),
        rrb.Tabs(*_motion(past), *(_errors(past) if has_truth else ())),
        row_shares=[1.8, 2, 4],
    )
    here = rrb.Vertical(_map(extent), rrb.Tabs(_beams(), _legend(), _models()), row_shares=[7, 3])
    return _under_the_bar(rrb.Horizontal(here, rrb.Vertical(curves, _events(), row_shares=[3, 2])))


def _researcher(extent: Extent | None, past: Past, _: bool) -> rrb.Container:
    """What does the eigenspace make of a scan?"""
    space = rrb.Vertical(_eigenspace(), rrb.Tabs(_belief(past), _beams()), row_shares=[7, 2])
    scan = rrb.Vertical(_curves(), rrb.Tabs(_map(extent), _legend()), row_shares=[5, 4])
    return _under_the_bar(rrb.Horizontal(space, scan, column_shares=[6, 5]))


def _fleet(extent: Extent | None, past: Past, _: bool) -> rrb.Container:
    """Which robot needs me?"""
    below = rrb.Horizontal(
        _map(extent), rrb.Vertical(_events(), rrb.Tabs(_state(past), _legend())), column_shares=[7, 4]
    )
    return rrb.Vertical(_board(), below, row_shares=[4, 9])


def _under_the_bar(panels: rrb.Container) -> rrb.Container:
    return rrb.Vertical(_board(), panels, row_shares=[1, 12])


def _board() -> rrb.View:
    return rrb.Spatial2DView(origin="status", name="State", titlebar=False, background=[30, 30, 30])


def _map(extent: Extent | None) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="world",
        name="Where (map, north up)",
        background=UNKNOWN_FLOOR,
        line_grid=False,
        eye_controls=eye(extent),
        overrides={"world/regions": rrb.EntityBehavior(visible=False)},
    )


def eye(extent: Extent | None) -> rrb.EyeControls3D | None:
    """Straight above the middle, high enough to see all of the map."""
    if extent is None:
        return None
    low, high = np.asarray(extent[0], dtype=np.float64), np.asarray(extent[1], dtype=np.float64)
    middle, size = (low + high) / 2, high - low
    height = MARGIN * max(size[1], size[0] / ASPECT) / 2 / np.tan(FIELD_OF_VIEW / 2)
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=[middle[0], middle[1], height],
        look_target=[middle[0], middle[1], 0.0],
        eye_up=[0.0, 1.0, 0.0],
    )


def _state(past: Past) -> rrb.View:
    return rrb.StateTimelineView(origin="state", name="State over time", time_ranges=past)


def _belief(past: Past) -> rrb.View:
    return rrb.TimeSeriesView(
        origin="belief",
        name="How sure (1 = certain)",
        axis_y=rrb.ScalarAxis(range=(-0.03, 1.03)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
        time_ranges=past,
    )


def _errors(past: Past) -> tuple[rrb.View, rrb.View]:
    return (
        rrb.TimeSeriesView(origin="error/position", name="Error, m", time_ranges=past),
        rrb.TimeSeriesView(origin="error/heading", name="Heading error, deg", time_ranges=past),
    )


def _motion(past: Past) -> tuple[rrb.View, rrb.View]:
    return (
        rrb.TimeSeriesView(origin="motion/speed", name="Speed, m/s", time_ranges=past),
        rrb.TimeSeriesView(origin="motion/turn", name="Turn rate, deg/s", time_ranges=past),
    )


def _models() -> rrb.View:
    return rrb.TextDocumentView(origin="models", name="Models")


def _raw() -> rrb.View:
    return rrb.Spatial3DView(
        origin="raw", name="Raw scans (robot's frame, forward is right)", background=[255, 255, 255]
    )


def _frames() -> rrb.View:
    return rrb.Spatial3DView(origin="frames", name="Frames")


def _beams() -> rrb.View:
    return rrb.BarChartView(origin="beams", name="Beams")


def _eigenspace() -> rrb.View:
    return rrb.Spatial3DView(origin="eigenspace", name="Eigenspace", line_grid=False)


def _curves() -> rrb.View:
    across, down = BOUNDS
    return rrb.Spatial2DView(
        origin="curves",
        name="Scan and eigen-scans (left to right as the robot looks)",
        background=[255, 255, 255],
        visual_bounds=rrb.VisualBounds2D(x_range=across, y_range=down),
    )


def _legend() -> rrb.View:
    return rrb.TextDocumentView(origin="legend", name="What the colours mean")


def _events() -> rrb.View:
    # without the entity's path, which each text begins with, the time has room
    columns = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin="events", name="Events", columns=columns)


def _past(window_s: float | None) -> Past:
    if window_s is None:
        return None
    return [
        rr.VisibleTimeRange(
            TIMELINE,
            start=rr.TimeRangeBoundary.cursor_relative(seconds=-window_s),
            end=rr.TimeRangeBoundary.cursor_relative(seconds=ROOM_AHEAD * window_s),
        )
    ]
