"""A scan-ingest on bare Zenoh that is wrong in one way: `python odd_ingest.py FAULT`; `none` is right."""

import os
import signal
import sys
import threading
import time
from collections.abc import Mapping

import zenoh
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.schemas.channels import HEALTH, SCAN, SCAN_RAW, Channel, ContractError
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.wire import decode, encode, encoding

fault = sys.argv[1]
site, robot, instance = (os.environ[f"EIGENSCAN_{name}"] for name in ("SITE", "ROBOT", "INSTANCE"))
core = ScanIngestCore(ScanIngestSettings())
counters = {"undecodable": 0}
over = threading.Event()
if fault != "deaf-to-sigterm":
    signal.signal(signal.SIGTERM, lambda *_: over.set())
else:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
session = zenoh.open(zenoh.Config.from_file(os.environ["EIGENSCAN_ZENOH"]))


def send(key: str, payload: bytes, declared: str, channel: Channel) -> None:
    other = fault == "other-qos" and channel is SCAN
    priority = zenoh.Priority.DATA if other else getattr(zenoh.Priority, channel.qos.priority.name)
    express = channel.qos.express and not other
    session.put(key, payload, encoding=zenoh.Encoding(declared), priority=priority, express=express)


def on_sample(sample: zenoh.Sample) -> None:
    key = str(sample.key_expr)
    if sample.kind != zenoh.SampleKind.PUT:
        return
    try:
        message = decode(SCAN_RAW, sample.payload.to_bytes(), str(sample.encoding))
    except ContractError:
        counters["undecodable"] += fault != "miscounts"
        if fault == "dies-on-garbage":
            print("cannot decode, goodbye", flush=True)
            os._exit(3)
        return
    lidar = SCAN_RAW.parse(key)
    assert lidar is not None
    for published in core.handle(Envelope(SCAN_RAW, lidar, message)):
        if published.channel is SCAN:
            answer(published.address, published.open(Scan))


def answer(address: Mapping[str, str], scan: Scan) -> None:
    if fault == "arrival-time":
        scan.timestamp.FromNanoseconds(time.time_ns())
    if fault == "metres-off":
        scan.ranges[:] = [r + 0.5 if 1.0 < r < 3.0 else r for r in scan.ranges]
    if fault == "slow":
        time.sleep(0.04)
    lidar = address["lidar"]
    key = f"{site}/robot/{robot}/scans/{lidar}" if fault == "other-key" else SCAN.key(address)
    declared = encoding(SCAN).replace("Scan/1", "Scan/2") if fault == "other-schema" else encoding(SCAN)
    send(key, encode(scan), declared, SCAN)


subscriber = session.declare_subscriber(f"{site}/robot/{robot}/scan/raw/*", on_sample)
if fault != "no-liveliness":
    token = session.liveliness().declare_token(f"{site}/alive/scan-ingest/{instance}/1")
address = {"site": site, "service": "scan-ingest", "instance": instance}
while not over.is_set():
    health = Health(service="scan-ingest", instance=instance, status=Health.STATUS_OK, counters=counters)
    health.timestamp.FromNanoseconds(time.time_ns())
    send(HEALTH.key(address), encode(health), encoding(HEALTH), HEALTH)
    over.wait(1.0)
session.close()
