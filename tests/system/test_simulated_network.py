"""A story on the simulated network and on Zenoh: the same publications in, the same publications out."""

from __future__ import annotations

import pytest
from eigenscan.schemas.channels import (
    HYPOTHESES,
    ODOMETRY,
    POSE,
    SCAN,
    SCAN_MOTION,
    SCAN_RAW,
    TRACKS,
    find,
)
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.wire import decode, encode, encoding
from eigenscan.workbench.simtest.session import Sample, Session
from eigenscan.workbench.simtest.site import Plan, Site

from tests.system.house import House

pytestmark = pytest.mark.slow

SEED, SECONDS = 20_000, 40.0
PLAN = Plan(robots=1, scan_hz=2.0, odometry_hz=10.0, faults_s=0.0, ingest=True)
GIVEN = (SCAN_RAW, ODOMETRY, HYPOTHESES)
"""Published by drivers, and by the projector, which here only knows the truth."""
COMPARED = (SCAN, SCAN_MOTION, TRACKS, POSE)

Published = dict[tuple[str, int], list[bytes]]
"""Messages by channel and stamp, ns: they may come in another order."""


def simulated() -> list[Envelope]:
    """All that a simulated site without a fault publishes, in order."""
    site, output = Site(SEED, PLAN), list[Envelope]()

    def note(_session: Session, sample: Sample) -> None:
        found = find(sample.key_expr)
        assert found is not None
        output.append(Envelope(*found, decode(found[0], sample.payload)))

    site.network.observer = note
    for process in site.processes:  # before the first message, as in the house
        process.is_wanted = True
        process.start()
    site.agenda.run(1.0)
    site.begin()
    site.agenda.run(SECONDS)
    for process in site.processes:
        process.is_wanted = False
        process.stop()
    return output


def by_stamp(messages: list[Envelope]) -> Published:
    found: Published = {}
    for one in messages:
        if one.channel in COMPARED:
            found.setdefault((one.channel.name, one.stamp), []).append(encode(one.message))
    return found


def test_zenoh_gives_what_the_simulated_network_gives(house: House) -> None:
    story = simulated()
    house.start("scan-ingest", "--robot", "r1")
    house.start("tracker", "--robot", "r1")
    publishers = {
        channel: house.session.declare_publisher(
            channel.key({"site": house.site, "robot": "r1", "lidar": "front", "projector": "r1"}),
            encoding=encoding(channel),
        )
        for channel in GIVEN
    }
    lists = 0
    for one in story:
        if one.channel not in GIVEN:
            continue
        if one.channel is HYPOTHESES:  # a projector has its scan before it answers
            stamp = one.stamp

            def has_scan(received: list[Envelope], stamp: int = stamp) -> bool:
                return any(e.channel is SCAN and e.stamp == stamp for e in received)

            house.ear.wait_for(has_scan, f"the scan of {stamp}")
            lists += 1
        publishers[one.channel].put(encode(one.message))
    house.until("tracker", lambda health: health.counters["heard_hypotheses"] == lists, "has all lists")
    for service in ("scan-ingest", "tracker"):
        assert house.terminate(service) == 0
    expected = by_stamp(story)
    assert sum(channel == POSE.name for channel, _ in expected) > 0.9 * lists > 0
    house.ear.wait_for(lambda received: len(by_stamp(received)) >= len(expected), "all answers")
    assert by_stamp(house.ear.received) == expected
