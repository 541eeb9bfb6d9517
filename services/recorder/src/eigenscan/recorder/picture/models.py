"""The models and the map in use: a page on the set, its floors on the map, and a line at each change."""

from __future__ import annotations

import numpy as np
import rerun as rr
from eigenscan.recorder.picture.canvas import Canvas
from eigenscan.recorder.picture.palette import REGION
from eigenscan.recorder.picture.shapes import is_place, lift
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import ModelSet

LISTED = 200
"""Regions that the page names."""


class ModelsPicture:
    """Draws model sets. A set without a stamp holds from the newest thing drawn on."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._version = ""

    def draw(self, received: Envelope) -> None:
        """The page, the outline and name of each floor; an event where another version came."""
        message = received.open(ModelSet)
        self._canvas.fix("models", rr.TextDocument(_page(message), media_type=rr.MediaType.MARKDOWN))
        for floor in message.floors:
            corners = min(len(floor.outline_x), len(floor.outline_y))
            outline = np.column_stack([floor.outline_x[:corners], floor.outline_y[:corners]])
            if corners >= 3 and is_place(outline):
                path = f"world/floors/{rr.escape_entity_path_part(floor.name or '-')}"
                self._canvas.fix(
                    path,
                    rr.LineStrips3D(
                        [lift(np.concatenate([outline, outline[:1]]), 0.01)],
                        colors=[REGION],
                        labels=[floor.name],
                        radii=rr.Radius.ui_points(1.5),
                    ),
                )
        if message.version != self._version and self._canvas.newest:
            text = f"models {message.version[:12]}: {len(message.entries)} regions"
            level = rr.TextLogLevel.INFO
            self._canvas.draw(self._canvas.newest, "events/models", rr.TextLog(text, level=level))
        self._version = message.version


def _page(message: ModelSet) -> str:
    wire_bytes = sum(entry.size for entry in message.entries)
    lines = [
        f"**Models {message.version[:12]}** of map {message.map_version[:12]}, frame `{message.frame_id}`",
        "",
        f"{len(message.entries)} regions, {message.free_area_m2:.0f} m², {wire_bytes / 1e6:.2f} MB",
        "",
        *(f"- floor **{floor.name}**" for floor in message.floors),
        "",
        "| region | version | kB |",
        "|---|---|---|",
        *(
            f"| {entry.region} | {entry.version[:12]} | {entry.size / 1e3:.0f} |"
            for entry in message.entries[:LISTED]
        ),
    ]
    left_out = len(message.entries) - LISTED
    return "\n".join([*lines, *([f"and {left_out} more"] if left_out > 0 else [])])
