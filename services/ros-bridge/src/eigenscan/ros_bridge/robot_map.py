"""Takes the robot's own map, from a map_server or from SLAM."""

from __future__ import annotations

import queue

from eigenscan.geometry.gridmap import GridMap, MapError
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.endpoints import Endpoint, Qos, Role
from eigenscan.ros_bridge.inbound import grid_map
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.session import dialect_of, open_towards_ros, subscribe
from eigenscan.ros_bridge.settings import qualified


def take_map(settings: RosBridgeOptions, patience_s: float) -> GridMap:
    """The robot's OccupancyGrid; waits at most `patience_s` for it.

    Raises MapError if none arrives or it is invalid; ContractError if no session opens.
    """
    name = qualified(settings.namespace, settings.map)
    endpoint = Endpoint(name, cdr.OCCUPANCY_GRID, Role.SUBSCRIPTION, Qos(1, transient_local=True))
    received: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    with open_towards_ros(settings, patience_s) as session:
        subscriber = subscribe(
            session,
            dialect_of(settings, session).key(endpoint),
            endpoint,
            lambda sample: received.put(sample.payload.to_bytes()),
        )
        try:
            data = received.get(timeout=patience_s)
        except queue.Empty:
            raise MapError(
                f"no map on {name} of domain {settings.domain} for {patience_s:g} s: does a map_server run, "
                f"and the Zenoh router at {settings.ros_zenoh or settings.ros_router}?"
            ) from None
        finally:
            subscriber.undeclare()
    try:
        return grid_map(cdr.decode(cdr.OCCUPANCY_GRID, data))
    except (cdr.CdrError, MapError) as error:
        raise MapError(f"{name}: {error}") from error
