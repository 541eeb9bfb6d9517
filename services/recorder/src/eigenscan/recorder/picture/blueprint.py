"""The layout: one bar to read from across the room, the map below it, the evidence beside it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from eigenscan.recorder.picture.canvas import TIMELINE
from numpy.typing import ArrayLike

FIELD_OF_VIEW = np.deg2rad(55.0)
"""Of the viewer's eye, vertically."""
UNKNOWN_FLOOR = [112, 137, 134]
"""As the map's texture shows what is unknown."""
ASPECT = 1.35
"""Width over height of the map's panel on a usual screen."""


def layout(extent: tuple[ArrayLike, ArrayLike] | None, window_s: float | None, live: bool) -> rrb.Blueprint:
    """Panels for any number of robots.

    `extent`: low and high corner of the map, m, which the eye takes in; `window_s`: s of the past that time
    plots show, None for everything; `live`: the newest is followed.
    """
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Spatial2DView(origin="status", name="State", titlebar=False, background=[30, 30, 30]),
            rrb.Horizontal(_map(extent), _evidence(window_s), column_shares=[7, 4]),
            row_shares=[1, 12],
        ),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="following" if live else "playing",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _map(extent: tuple[ArrayLike, ArrayLike] | None) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="world",
        name="Where (map, north up)",
        background=UNKNOWN_FLOOR,
        line_grid=False,
        eye_controls=_eye(extent),
        overrides={"world/regions": rrb.EntityBehavior(visible=False)},
    )


def _eye(extent: tuple[ArrayLike, ArrayLike] | None) -> rrb.EyeControls3D | None:
    """Straight above the middle, high enough to see all of the map."""
    if extent is None:
        return None
    low, high = np.asarray(extent[0], dtype=np.float64), np.asarray(extent[1], dtype=np.float64)
    middle, size = (low + high) / 2, high - low
    height = 1.04 * max(size[1], size[0] / ASPECT) / 2 / np.tan(FIELD_OF_VIEW / 2)
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=[middle[0], middle[1], height],
        look_target=[middle[0], middle[1], 0.0],
        eye_up=[0.0, 1.0, 0.0],
    )


def _evidence(window_s: float | None) -> rrb.Vertical:
    ranges = _past(window_s)
    return rrb.Vertical(
        rrb.StateTimelineView(origin="state", name="State over time", time_ranges=ranges),
        rrb.TimeSeriesView(
            origin="belief",
            name="How sure (1 = certain)",
            axis_y=rrb.ScalarAxis(range=(-0.03, 1.03)),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
            time_ranges=ranges,
        ),
        rrb.Tabs(
            rrb.TimeSeriesView(origin="error/position", name="Error, m", time_ranges=ranges),
            rrb.TimeSeriesView(origin="error/heading", name="Heading error, deg", time_ranges=ranges),
        ),
        rrb.Tabs(
            rrb.TextDocumentView(origin="legend", name="What the colours mean"),
            rrb.BarChartView(origin="beams", name="Beams"),
            rrb.Spatial3DView(origin="eigenspace", name="Eigenspace", line_grid=False),
            rrb.TextLogView(origin="events", name="Events"),
        ),
        row_shares=[1.2, 2, 2, 5],
    )


def _past(window_s: float | None) -> Sequence[rr.VisibleTimeRange] | None:
    if window_s is None:
        return None
    return [
        rr.VisibleTimeRange(
            TIMELINE,
            start=rr.TimeRangeBoundary.cursor_relative(seconds=-window_s),
            end=rr.TimeRangeBoundary.cursor_relative(seconds=0.0),
        )
    ]
