"""Hears what a running pipeline says: the health of each service, and the poses."""

from __future__ import annotations

from collections.abc import Iterable

from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import HEALTH, POSE, ContractError
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.wire import decode

AWAIT_MODEL = ("mapbuilder", "projector")
"""The services that work once they have the model; the others wait for scans only."""


class Witness:
    """Keeps the newest health of each service; gives each pose once."""

    def __init__(self, bus: Bus, site: str) -> None:
        self._inbox = Inbox()
        self.health: dict[str, Health] = {}
        bus.listen([HEALTH, POSE], {"site": site}, self._inbox)

    def listen(self) -> list[PoseEstimate]:
        """Takes in what was heard since the last call; gives the poses."""
        poses: list[PoseEstimate] = []
        while (arrival := self._inbox.take(0.0)) is not None:
            try:
                message = decode(arrival.channel, arrival.payload, arrival.encoding)
            except ContractError:
                continue  # whoever said it is not of this contract, and not ours to judge
            if isinstance(message, Health):
                self.health[message.service] = message
            elif isinstance(message, PoseEstimate):
                poses.append(message)
        return poses

    def missing(self, services: Iterable[str]) -> list[str]:
        """What is still to come before `services` work: names, with what they say they lack."""
        lacking = []
        for service in services:
            health = self.health.get(service)
            if health is None:
                lacking.append(service)
            elif service in AWAIT_MODEL and health.status == Health.STATUS_WAITING:
                lacking.append(f"{service} ({health.detail})")
        return lacking
