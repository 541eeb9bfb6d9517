"""The code on the contract's page, run as it stands but for the site and the way there."""

import json
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import MEETING
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

from tests.environment import ROOT

PAGE = ROOT / "docs/contract.md"


def test_the_example_hears_a_pose(net: Any, buses: Callable[[], Bus]) -> None:
    (code,) = re.findall(r"```python[^\n]*\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (endpoint,) = json.loads(net.leaf.read_text())["connect"]["endpoints"]
    code = code.replace('"site/', f'"{net.site}/').replace(MEETING, endpoint)
    code = code.replace("zenoh.Config()", f"zenoh.Config.from_file({str(net.leaf)!r})")
    bus = buses()
    estimate = PoseEstimate(pose=Pose2(x=1.5, y=-2.0), state=STATE_LOCALIZED, confidence=0.875)
    over = threading.Event()

    def say() -> None:
        while not over.wait(0.02):
            bus.say(Envelope(POSE, {"site": net.site, "robot": "r"}, estimate))

    thread = threading.Thread(target=say)
    thread.start()
    with subprocess.Popen([sys.executable, "-u", "-c", code], stdout=subprocess.PIPE, text=True) as stranger:
        assert stranger.stdout
        line = stranger.stdout.readline()
        stranger.kill()
    over.set()
    thread.join()
    assert line == f"{net.site}/robot/r/pose STATE_LOCALIZED 1.5 -2.0 0.875\n"
