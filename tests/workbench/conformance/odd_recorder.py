"""A recorder of few lines that is wrong in one way: `python odd_recorder.py FAULT`; `none` is right."""

import os
import signal
import sys
import threading
import time
from pathlib import Path

from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.recording import RecordingWriter, writing
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import CHANNELS, HEALTH, POSE, ContractError
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import decode

fault = sys.argv[1]
site, instance, zenoh, folder = (
    os.environ[f"EIGENSCAN_{name}"] for name in ("SITE", "INSTANCE", "ZENOH", "RECORDING")
)
over, counters, number = threading.Event(), {"undecodable": 0}, 0
signal.signal(signal.SIGTERM, lambda *_: over.set())
bus, inbox = Bus(open_session(Path(zenoh))), Inbox()
channels = [c for c in CHANNELS if not (fault == "no-past" and c.qos.latched)]
bus.listen(channels, {"site": site}, inbox)
bus.announce(site, "recorder", instance)
if fault == "never-flushes":
    writing.CHUNK_BYTES = 2**30  # nor does a chunk that is full reach the file
writer, reported, flushed = RecordingWriter(Path(folder) / "a.mcap"), 0.0, 0.0
while not over.is_set():
    if time.monotonic() - reported > 1.0:
        reported = time.monotonic()
        health = Health(service="recorder", instance=instance, status=Health.STATUS_OK, counters=counters)
        health.timestamp.CopyFrom(stamp(time.time_ns()))
        bus.publish(Envelope(HEALTH, {"site": site, "service": "recorder", "instance": instance}, health))
    arrival = inbox.take(0.05)
    if arrival is None:
        continue
    try:
        message = decode(arrival.channel, arrival.payload, arrival.encoding)
    except ContractError:
        counters["undecodable"] += 1
        continue
    number += 1
    if fault == "loses-some" and number % 50 == 0:
        continue
    if fault == "changes-poses" and arrival.channel is POSE:
        message.confidence = 0.5  # type: ignore[attr-defined]
    now = time.time_ns()
    own = nanoseconds(message.timestamp) if hasattr(message, "timestamp") else 0
    address = arrival.channel.parse(arrival.key) or {}
    if fault == "arrival-as-stamp":
        own = now
    writer.write(Envelope(arrival.channel, address, message), now, own if own > 0 else now)
    if fault != "never-flushes" and time.monotonic() - flushed > 0.3:
        flushed = time.monotonic()
        writer.flush()
bus.close()
writer.close()
