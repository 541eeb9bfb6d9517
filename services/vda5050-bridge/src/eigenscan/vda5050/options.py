"""Settings of the bridge's process."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.group import is_one
from eigenscan.vda5050.settings import SERIAL_NUMBER, Vda5050Settings
from pydantic import Field, field_validator, model_validator

PORTS = {"mqtt": 1883, "mqtts": 8883}


class Vda5050Options(Vda5050Settings, ServiceSettings):
    """Settings of vda5050-bridge: a robot's pose for fleet managers that speak VDA 5050."""

    broker: str = Field("mqtt://127.0.0.1:1883", description="MQTT broker; mqtts:// for TLS")
    interface: str = Field("", description="first levels of topics; default: uagv/v2 or vda5050/v3")
    username: str = Field("", description="name at the broker")
    password_file: Path | None = Field(None, description="file with its password")
    ca_file: Path | None = Field(None, description="the broker's authority; default: the system's")

    @property
    def address(self) -> tuple[str, int, bool]:
        """Host, port, and whether TLS is spoken."""
        url = urlsplit(self.broker)
        return url.hostname or "", url.port or PORTS[url.scheme], url.scheme == "mqtts"

    @property
    def serial(self) -> str:
        """The robot's serial number."""
        return self.serial_number or self.robot

    @property
    def topics(self) -> str:
        """Begin of all topics."""
        interface = self.interface or {2: "uagv/v2", 3: "vda5050/v3"}[self.major]
        return f"{interface}/{self.manufacturer}/{self.serial}"

    @field_validator("broker")
    @classmethod
    def _is_a_broker(cls, value: str) -> str:
        url = urlsplit(value)
        if url.username is not None:
            raise ValueError("must have no user in it: give username and password_file")
        if url.port == 0 or url.scheme not in PORTS or not url.hostname or url.path.strip("/"):
            raise ValueError("must be such as mqtt://10.0.0.5:1883 or mqtts://broker")
        return value

    @field_validator("robot")
    @classmethod
    def _one_robot(cls, value: str) -> str:
        if not is_one(value):
            raise ValueError("must be one robot: start a bridge for each")
        return value

    @model_validator(mode="after")
    def _has_a_serial_number(self) -> Vda5050Options:
        if not SERIAL_NUMBER.fullmatch(self.serial):
            raise ValueError(f"serial_number: {self.serial!r} must consist of A-Z a-z 0-9 _ . : -")
        return self
