"""A summary of an import, on one screen."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from eigenscan.geometry.doubtful_ranges import not_in_metres
from eigenscan.geometry.message_floats import floats_of
from eigenscan.ingest.core import WHY, ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.runtime.printable import printable
from eigenscan.schemas.channels import ODOMETRY, SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.workbench.logs.log import Log
from eigenscan.workbench.logs.remarks import remarks
from rich.console import Console
from rich.table import Table


@dataclass
class _Row:
    """One lidar, or odometry."""

    messages: int = 0
    first: int = 0
    last: int = 0
    about: str = ""
    beams: Counter[int] = field(default_factory=Counter)
    not_in_metres: int = 0
    core: ScanIngestCore = field(default_factory=lambda: ScanIngestCore(ScanIngestSettings()))
    is_usable: bool = False  # whether a scan has a beam that scan-ingest takes

    @property
    def seconds(self) -> float:
        return (self.last - self.first) * 1e-9

    @property
    def rate(self) -> str:
        return f"{(self.messages - 1) / self.seconds:.1f}" if self.seconds > 0 else "-"


class Summary:
    """Counts the imported messages."""

    def __init__(self) -> None:
        self._rows: dict[str, _Row] = {}

    @property
    def lidars(self) -> list[str]:
        """Names of those that were received."""
        return sorted(name for name, row in self._rows.items() if row.beams)

    @property
    def not_in_metres(self) -> list[str]:
        """Names of lidars all of whose scans have ranges that are rather millimetres."""
        return sorted(name for name, row in self._rows.items() if row.not_in_metres == row.messages)

    @property
    def unusable(self) -> list[str]:
        """A line for each lidar of whose scans nothing can be made."""
        found = []
        for name, row in sorted(self._rows.items()):
            if row.beams and not row.is_usable:
                reasons = row.core.condition().counters
                why = next((WHY[each] for each in WHY if f"set_aside_{each}" in reasons), "no beam returned")
                found.append(f"lidar {name}: none of its {row.messages} scans can be used: {why}")
        return found

    def add(self, envelope: Envelope, time: int) -> None:
        """Takes note of a message with stamp `time`, ns."""
        name = envelope.address["lidar"] if envelope.channel is SCAN_RAW else envelope.channel.name
        row = self._rows.get(name)
        if row is None:
            row = self._rows[name] = _Row(first=time)
        row.messages += 1
        row.last = time
        if envelope.channel is SCAN_RAW:
            scan = envelope.open(RawScan)
            row.beams[len(scan.ranges)] += 1
            row.not_in_metres += not_in_metres(floats_of(scan, "ranges"))
            row.about = _about(scan)
            row.is_usable = row.is_usable or any(
                np.isfinite(floats_of(made.open(Scan), "ranges")).any()
                for made in row.core.handle(envelope)
                if made.channel is SCAN
            )

    def show(self, console: Console, log: Log, target: Path) -> None:
        """Prints the table and the rejected messages."""
        table = Table(title=printable(f"{log.path} ({log.format})"), title_justify="left")
        table.add_column("", overflow="fold")  # the name is needed whole, for --mount and --lidar-topic
        for column in ("messages", "Hz", "s", "beams"):
            table.add_column(column, justify="right")
        table.add_column("lidar and its mount")
        for name, row in sorted(self._rows.items()):
            beams = ", ".join(str(count) for count, _ in row.beams.most_common(3))
            table.add_row(name, str(row.messages), row.rate, f"{row.seconds:.1f}", beams, row.about)
        console.print(table)
        if ODOMETRY.name not in self._rows:
            console.print("no odometry")
        for line in (*remarks(log.counters), *self.unusable):
            console.print(printable(line), highlight=False, soft_wrap=True)
        if log.damage:
            console.print(printable(log.damage), highlight=False, soft_wrap=True)
        console.print(
            f"wrote {printable(str(target))} ({target.stat().st_size / 1e6:.1f} MB)", highlight=False
        )

    def figures(self, log: Log, target: Path) -> dict[str, object]:
        """The same for scripts: by lidar and by channel."""
        return {
            "log": str(log.path),
            "format": log.format,
            "messages": {
                name: {"count": row.messages, "seconds": row.seconds, "beams": sorted(row.beams)}
                for name, row in sorted(self._rows.items())
            },
            "set_aside": dict(sorted((+log.counters).items())),
            "unusable": self.unusable,
            "damage": log.damage,
            "recording": str(target),
        }


def _about(scan: RawScan) -> str:
    step = math.degrees(scan.angle_increment)
    limit = f"{scan.range_max:g} m" if scan.range_max else "limit not stated"
    mount = scan.mount
    place = f"{mount.x:.3f} m, {mount.y:.3f} m, {math.degrees(mount.theta):.1f}°"
    turned = ", upside down" if scan.upside_down else ""
    return f"{abs(step) * len(scan.ranges):.0f}° by {abs(step):.3g}°, {limit}; at {place}{turned}"
