"""Selects the messages of a recording to play."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import zenoh
from eigenscan.runtime.errors import UsageError
from eigenscan.runtime.recording import Contents, contents, read
from eigenscan.schemas.channels import CHANNELS, Channel, find
from eigenscan.workbench.simulation.stage import Timed

INPUTS = ("scan_raw", "odometry", "heading")
"""A pipeline's inputs; it computes all other channels itself."""


@dataclass(frozen=True)
class Selection:
    """Messages on `keys` of the site and of `robot` (None: all robots). Times are log times, ns."""

    file: Path
    keys: frozenset[str]
    robot: str | None
    start: int
    """Begin of the whole recording."""
    begin: int
    end: int

    @property
    def robots(self) -> list[str]:
        """Robots whose messages are played."""
        return [self.robot] if self.robot else _robots(self.keys)

    @property
    def latched(self) -> list[Channel]:
        """Played channels that a late subscriber asks for."""
        return [c for c in CHANNELS if c.qos.latched and any(c.parse(key) for key in self.keys)]

    def messages(self, begin: int) -> Iterator[Timed]:
        """The latched messages from before log time `begin`, then all from `begin` to the selection's end."""
        for record in read(self.file, max(begin, self.begin)):
            if record.log_time > self.end:
                return
            envelope = record.envelope
            if envelope.key in self.keys and self._is_of_robot(envelope.address.get("robot")):
                yield Timed(max(record.log_time, begin, self.begin), envelope)

    def _is_of_robot(self, robot: str | None) -> bool:
        return robot is None or self.robot is None or robot == self.robot


def select(
    file: Path, only: Sequence[str], robot: str | None, begin_s: float, end_s: float | None
) -> Selection:
    """The messages of `only` (channels or key expressions), between two times in s from the start.

    `robot` selects one robot of a recording that holds several.
    Raises UsageError if nothing is left.
    """
    if end_s is not None and end_s <= begin_s:
        raise UsageError(f"--to {end_s:g}: must be after --from {begin_s:g}")
    found = contents(file)
    if not found.messages:
        cut = "" if found.complete else ": it ends before the first whole chunk"
        raise UsageError(f"{file}: holds no message{cut}")
    keys = frozenset(_keys(found, only))
    if not keys:
        names = [channel.name for channel in CHANNELS if found.keys_of(channel)]
        held = ", ".join(names) or "no channel of ours"
        raise UsageError(f"{file}: holds nothing on {', '.join(only)}: it has {held}: choose with --only")
    robots = _robots(keys)
    chosen = robot if robot in robots else None
    if robot is not None and chosen is None and len(robots) > 1:
        raise UsageError(f"--robot {robot}: the recording holds {', '.join(robots)}: choose one of them")
    begin, end = found.stretch(begin_s, end_s)
    selection = Selection(file, keys, chosen, found.begin, begin, end)
    if begin > found.end or next(selection.messages(begin), None) is None:
        start, length_s = datetime.fromtimestamp(found.begin * 1e-9, UTC), (found.end - found.begin) * 1e-9
        held = f"it lasts {length_s:.1f} s from {start:%H:%M:%S} UTC"
        raise UsageError(f"{file}: nothing between --from and --to on {', '.join(only)}: {held}")
    return selection


def _keys(found: Contents, only: Sequence[str]) -> Iterator[str]:
    channels = {channel.name: channel for channel in CHANNELS}
    for name in only:
        if name in channels:
            yield from found.keys_of(channels[name])
        elif "/" in name:
            pattern = _key_expression(name)
            yield from (key for key in found.counts if pattern.intersects(key))
        else:
            raise UsageError(
                f"--only {name}: choose one of {', '.join(channels)}, or a key such as site/robot/r1/**"
            )


def _key_expression(text: str) -> zenoh.KeyExpr:
    try:
        return zenoh.KeyExpr(text)
    except zenoh.ZError as error:
        raise UsageError(f"--only {text}: is no key expression: {error}") from error


def _robots(keys: Iterable[str]) -> list[str]:
    addresses = (found[1] for found in map(find, keys) if found)
    return sorted({address["robot"] for address in addresses if "robot" in address})
