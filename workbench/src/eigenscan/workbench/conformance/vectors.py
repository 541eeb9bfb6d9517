"""Reads the contract's vectors: recordings of each service's inputs and expected outputs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import CONTRACT_VERSION, Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.simulation.stage import Timed

DRIVE, LIDARS, MAP_FILE = "drive.mcap", "lidars.mcap", "map.yaml"


def folder() -> Path:
    """The folder of this contract version's vectors, a part of the schemas."""
    with as_file(files("eigenscan.schemas") / "conformance" / f"contract-{CONTRACT_VERSION}") as path:
        return path


@dataclass(frozen=True)
class Vectors:
    """A service's inputs, and the reference's outputs."""

    latched: tuple[Envelope, ...]
    inputs: tuple[Timed, ...]
    reference: tuple[Envelope, ...]

    def parts(self, share: float) -> tuple[list[Timed], list[Timed]]:
        """The inputs before and after `share` of their time."""
        if not self.inputs:
            return [], []
        begin, end = self.inputs[0].time, self.inputs[-1].time
        cut = begin + share * (end - begin)
        return [t for t in self.inputs if t.time <= cut], [t for t in self.inputs if t.time > cut]


def load(
    file: str, inputs: Iterable[Channel], outputs: Iterable[Channel], address: dict[str, str]
) -> Vectors:
    """The vectors in `file` for a service with these channels, under other names of site and robot."""
    received, published = set(inputs), set(outputs)
    latched, timed, reference = [], [], []
    for record in read(folder() / file):
        own = record.envelope
        names = {name: value for name, value in address.items() if name in own.channel.fields}
        envelope = Envelope(own.channel, {**own.address, **names}, own.message)
        if own.channel in published:
            reference.append(envelope)
        elif own.channel in received and own.channel.qos.latched:
            latched.append(envelope)
        elif own.channel in received:
            timed.append(Timed(record.log_time, envelope))
    return Vectors(tuple(latched), tuple(timed), tuple(reference))
