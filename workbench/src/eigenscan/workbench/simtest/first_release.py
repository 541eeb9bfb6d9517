"""What a service of the first release publishes, made of what today's publishes."""

from __future__ import annotations

import hashlib
import zlib

from eigenscan.eigenspace.model import WITHOUT_SPACE, set_version
from eigenscan.schemas.channels import find
from eigenscan.schemas.model_pb2 import ModelSet, RegionModel
from eigenscan.schemas.wire import decode, encode
from google.protobuf.message import Message

CHANNELS = {
    *("scan_raw", "scan", "odometry", "hypotheses", "obstacles", "pose", "tracks", "transform", "truth"),
    *("map", "model", "model_set", "health"),
}
"""Those of its recording."""
LACKED: dict[str, tuple[str, ...]] = {
    "eigenscan.RawScan": ("time_increment", "stamped_after", "gathered"),
    "eigenscan.Scan": ("motion", "gathered"),
    "eigenscan.Hypotheses": ("motion", "search", "surfaces", "range_check", "cut", "inexactness", "gathered"),
    "eigenscan.RegionModel": ("space",),
    "eigenscan.ModelSet": ("floors",),
    "eigenscan.PoseEstimate": (
        *("protection_radius", "protection_angle", "protection_risk"),
        *("floor", "floor_pose", "extrapolated"),
    ),
    "eigenscan.Track": ("nis",),
    "eigenscan.Tracks": ("state",),
}
"""Fields that came later, by message."""


class FirstRelease:
    """One service's publications as the first release had them."""

    def __init__(self) -> None:
        self._entries: dict[str, ModelSet.Entry] = {}
        """Of models, by their versions of today."""

    def payload(self, key: str, payload: bytes) -> bytes | None:
        """The bytes on that key; None where the first release had no such channel."""
        found = find(key)
        if found is None or found[0].name not in CHANNELS:
            return None
        message = decode(found[0], payload)
        _strip(message)
        if isinstance(message, RegionModel):
            version = message.version
            message.format = WITHOUT_SPACE
            message.version = _version(message)
            size = message.ByteSize()
            self._entries[version] = ModelSet.Entry(region=message.region, version=message.version, size=size)
        elif isinstance(message, ModelSet):
            entries = [self._entries[entry.version] for entry in message.entries]
            del message.entries[:]
            message.entries.extend(entries)
            message.version = set_version(message.map_version, [entry.version for entry in entries])
        return encode(message)


def _version(model: RegionModel) -> str:
    plain = RegionModel.FromString(encode(model))
    plain.ClearField("version")
    plain.panoramas = zlib.decompress(plain.panoramas)
    return hashlib.sha256(encode(plain)).hexdigest()


def _strip(message: Message) -> None:
    for name in LACKED.get(message.DESCRIPTOR.full_name, ()):
        message.ClearField(name)
    for field, value in message.ListFields():
        if field.message_type is None or field.message_type.GetOptions().map_entry:
            continue
        for each in value if field.is_repeated else [value]:
            _strip(each)
