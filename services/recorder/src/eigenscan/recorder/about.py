"""The metadata of a file: services with their settings, and models."""

from __future__ import annotations

import json

from eigenscan.schemas.channels import HEALTH, MODEL_SET
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet

MOST_SERVICES = 10_000
"""Instances that one file states: those of 1,000 robots, with room. Made-up names take no more memory."""

Metadata = dict[str, dict[str, str]]


class About:
    """Keeps the newest word of each service instance on itself, and of each site's models."""

    def __init__(self) -> None:
        self._services: dict[str, str] = {}
        self._models: dict[str, str] = {}
        self._speaking: set[str] = set()

    def receive(self, received: Envelope) -> None:
        """Takes metadata from any message."""
        if received.channel is HEALTH:
            health = received.open(Health)
            entry = {"version": health.package_version, "settings": health.settings}
            who = f"{health.service}/{health.instance}"
            if who not in self._services and len(self._services) >= MOST_SERVICES:
                return
            self._services[who] = json.dumps(entry)
            self._speaking.add(who)
        elif received.channel is MODEL_SET:
            models = received.open(ModelSet)
            regions = {entry.region: entry.version for entry in models.entries}
            entry = {"version": models.version, "map": models.map_version}
            self._models[received.key] = json.dumps(entry | {"regions": regions})

    def begin_file(self) -> None:
        """Forgets services that were silent since the last call, because robots come and go."""
        self._services = {who: entry for who, entry in self._services.items() if who in self._speaking}
        self._speaking.clear()

    @property
    def metadata(self) -> Metadata:
        """`services`, by SERVICE/INSTANCE: version and settings; `models`, by key: versions. JSON each."""
        return {"services": dict(self._services), "models": dict(self._models)}
