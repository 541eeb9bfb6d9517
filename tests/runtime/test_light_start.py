"""A service that was killed is soon back: it imports nothing that its work does not need."""

import subprocess
import sys

import pytest
from eigenscan.cli.launch.supervision import ROS_BRIDGE, SERVICES

NODES = {**SERVICES, "ros-bridge": ROS_BRIDGE, "vda5050-bridge": "eigenscan.vda5050.node"}
COMPILED = {"numba", "scipy"}
"""Half of a start: while they are imported, the session opens."""
METRICS = {"prometheus_client", "http.server"}
"""Only where the settings name a port."""
FOREIGN = {
    *("matplotlib", "rerun", "pandas", "PIL", "filterpy", "rich", "typer", "dask", "distributed", "asyncio"),
    *(f"scipy.{part}" for part in ("stats", "optimize", "interpolate", "signal", "integrate", "io")),
    *("eigenscan.cli", "eigenscan.mapbuilder.mapping"),
}


def _imported(*modules: str) -> set[str]:
    code = f"import sys, {', '.join(modules)}; print(*sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(result.stdout.split())


@pytest.mark.parametrize("node", NODES.values(), ids=NODES)
def test_before_its_session_opens_a_service_imports_nothing_compiled(node: str) -> None:
    imported = _imported(node)
    assert node in imported
    assert not imported & (COMPILED | FOREIGN | METRICS)


@pytest.mark.parametrize("node", NODES.values(), ids=NODES)
def test_a_core_imports_only_what_it_works_with(node: str) -> None:
    imported = _imported(node, node.replace(".node", ".core"))
    assert not imported & FOREIGN


def test_what_needs_nothing_compiled_has_none_of_it() -> None:
    imported = _imported(*(f"eigenscan.{service}.core" for service in ("recorder", "ros_bridge", "vda5050")))
    assert not imported & COMPILED
