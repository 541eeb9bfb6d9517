"""The models and the map in use: a page on the set, its floors on the map, and a line at each change."""

from __future__ import annotations

import rerun as rr
from eigenscan.recorder.picture.canvas import Canvas
from eigenscan.recorder.picture.floor import Floor
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import ModelSet

LISTED = 200
"""Regions that the page names."""


class ModelsPicture:
    """Draws model sets. A set without a stamp holds from the newest thing drawn on."""

    def __init__(self, canvas: Canvas, floor: Floor) -> None:
        self._canvas, self._floor = canvas, floor
        self._version = ""

    def draw(self, received: Envelope) -> None:
        """The page, the outline and name of each floor; an event where another version came."""
        message = received.open(ModelSet)
        self._canvas.fix("models", rr.TextDocument(_page(message), media_type=rr.MediaType.MARKDOWN))
        for floor in message.floors:
            path = f"world/floors/{rr.escape_entity_path_part(floor.name or '-')}"
            self._floor.draw_outline(path, floor.outline_x, floor.outline_y, 1.5, floor.name)
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
