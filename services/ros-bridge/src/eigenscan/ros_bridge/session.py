"""Zenoh towards ROS 2: the session, its dialect, subscriptions."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import zenoh
from eigenscan.ros_bridge.endpoints import Dialect, Endpoint
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.rmw_zenoh import RmwZenoh
from eigenscan.ros_bridge.ros2dds import Ros2Dds
from eigenscan.runtime.logs import logger
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import ContractError

_THIS_MACHINE = ("localhost", "127.0.0.1", "[::1]")


def subscribe(
    session: zenoh.Session, key: str, endpoint: Endpoint, on_sample: Callable[[zenoh.Sample], None]
) -> Any:
    """Subscriber of a topic; on a transient local one it also receives earlier messages."""
    # in the session's own thread, which saves a thread switch
    received = zenoh.handlers.Callback(on_sample, indirect=False)
    # on /tf, its own messages would return
    remote = zenoh.Locality.REMOTE
    if not endpoint.qos.transient_local:
        return session.declare_subscriber(key, received, allowed_origin=remote)
    return zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        received,
        allowed_origin=remote,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=endpoint.qos.depth),
        recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        subscriber_detection=True,
    )


def dialect_of(settings: RosBridgeOptions, session: zenoh.Session) -> Dialect:
    """The robot's dialect, for declarations on `session`."""
    zid = str(session.zid())
    if settings.dialect == "ros2dds":
        return Ros2Dds(zid)
    hashed = settings.dialect == "rmw_zenoh"
    return RmwZenoh(settings.domain, settings.namespace, zid, hashed=hashed)


def open_towards_ros(settings: RosBridgeOptions, patience_s: float | None = None) -> zenoh.Session:
    """A peer of the ROS nodes on this machine, or the client of a router on another one.

    It waits for that router, without end if there is no `patience_s`. Raises ContractError if no session
    opens.
    """
    if settings.ros_zenoh:
        return open_session(settings.ros_zenoh)
    host = settings.ros_router.partition("/")[2].rpartition(":")[0]
    mode = "peer" if host in _THIS_MACHINE else "client"
    if mode == "client":
        logger().info("waiting_for_router", ros_router=settings.ros_router)
    patient = mode == "peer" or patience_s is None
    config = {
        # ROS nodes listen on their own machine only: from another one all goes through the router
        "mode": mode,
        "listen": {"endpoints": {"peer": ["tcp/localhost:0"]}},
        "connect": {
            "endpoints": [settings.ros_router],
            "exit_on_failure": not patient,
            "timeout_ms": -1 if patient else round(1e3 * (patience_s or 0.0)),
        },
        "scouting": {"multicast": {"enabled": False}},
        "timestamping": {"enabled": True},
    }
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as error:
        raise ContractError(f"ros_router = {settings.ros_router!r}: no Zenoh session: {error}") from error
