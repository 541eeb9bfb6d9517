"""Checks keys, encodings and quality of service of a candidate's messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from eigenscan.schemas.channels import HEALTH, Channel
from eigenscan.schemas.wire import encoding
from eigenscan.workbench.conformance.check import Check, check
from eigenscan.workbench.conformance.receiving import Received
from eigenscan.workbench.conformance.trial import Observed


def travelling(seen: Observed) -> Iterator[Check]:
    """Checks of keys, schemas and quality of service."""
    outputs = {*seen.profile.outputs, HEALTH}
    keys: list[str] = []
    schemas: list[str] = []
    qos: list[str] = []
    for one in _first_of_each_key(seen.received):
        address = {name: one.address[name] for name in ("site", "robot") if name in one.address}
        if one.channel is None:
            keys.append(f"{one.key} is no key of the contract")
        elif one.channel not in outputs:
            keys.append(f"{one.key}: {one.channel.name} is not an output of a {seen.profile.name}")
        elif any(seen.address[name] != value for name, value in address.items()):
            keys.append(f"{one.key}: is not of the robot or site that it serves")
        else:
            qos += _qos_faults(one, one.channel)
    for one in seen.received:
        if one.channel in outputs and one.channel is not None:
            wanted = encoding(one.channel)
            if one.message is None:
                schemas.append(f"{one.key}: {one.fault or 'a deletion'}")
            elif one.encoding != wanted:
                schemas.append(f"{one.key}: encoding {one.encoding!r}, the contract has {wanted!r}")
    count, spoken = (
        len(seen.received),
        {one.channel.name for one in seen.received if one.channel in outputs and one.channel},
    )
    yield check("keys", "Keys", keys, f"{count} samples on {', '.join(sorted(spoken))}")
    yield check("schema", "Samples", schemas, f"{count} samples decode and name their schema")
    yield check("qos", "Quality of service", qos, "priority, congestion control and express as in the table")


def _first_of_each_key(received: Sequence[Received]) -> list[Received]:
    found: dict[tuple[str, str, bool, bool], Received] = {}
    for one in received:
        found.setdefault((one.key, one.priority, one.block, one.express), one)
    return list(found.values())


def _qos_faults(one: Received, channel: Channel) -> Iterator[str]:
    qos = channel.qos
    for name, got, want in (
        ("priority", one.priority, qos.priority.name),
        ("congestion control", "block" if one.block else "drop", "block" if qos.block else "drop"),
        ("express", "yes" if one.express else "no", "yes" if qos.express else "no"),
    ):
        if got != want:
            yield f"{one.key}: {name} {got}, the contract has {want}"
