import re
import socket
import time
from urllib.request import urlopen

import pytest
from eigenscan.runtime.health import LEVELS, Monitor
from eigenscan.runtime.metrics import Metrics
from eigenscan.runtime.settings import SettingsError
from eigenscan.schemas.envelope import Condition
from eigenscan.schemas.health_pb2 import Health
from prometheus_client.parser import text_string_to_metric_families

from tests.environment import ROOT

OK = Condition(Health.STATUS_OK, "well", {"heard": 3, "waiting": 2, "regions": 7})


def test_it_starts_then_turns_then_stalls() -> None:
    monitor = Monitor("probe", "0", "1.2.3")
    assert monitor.probe()[0] == 503
    assert monitor.message().status == Health.STATUS_WAITING
    assert monitor.turn(OK) is True
    code, body = monitor.probe()
    assert (code, body["status"], body["stalled"]) == (200, "STATUS_OK", False)

    still = Monitor("probe", "0", "1.2.3", stalled_after_s=0.0)
    still.turn(OK)
    code, body = still.probe()
    assert (code, body["status"], body["stalled"]) == (503, "STATUS_DEGRADED", True)
    message = still.message()
    assert message.status == Health.STATUS_DEGRADED
    assert "no answer from the core" in message.detail
    assert message.counters == OK.counters


def test_a_service_that_waits_or_is_degraded_is_alive() -> None:
    monitor = Monitor("probe", "0", "1.2.3")
    for status in (Health.STATUS_WAITING, Health.STATUS_DEGRADED):
        monitor.turn(Condition(status, "no model"))
        assert monitor.probe()[0] == 200


def test_a_change_is_one_of_status_or_detail() -> None:
    monitor = Monitor("probe", "0", "")
    assert monitor.turn(OK)
    assert not monitor.turn(Condition(OK.status, OK.detail, {"heard": 4}))
    assert monitor.turn(Condition(OK.status, "other"))
    assert monitor.turn(Condition(Health.STATUS_WAITING, "other"))


def test_the_message_states_who_and_how() -> None:
    monitor = Monitor("probe", "r7", "1.2.3")
    monitor.turn(OK)
    message = monitor.message()
    assert (message.service, message.instance, message.package_version) == ("probe", "r7", "1.2.3")
    assert (message.status, message.detail, message.counters) == (Health.STATUS_OK, "well", OK.counters)
    assert message.timestamp.seconds > 1_700_000_000


def test_what_a_stranger_wrote_is_cut_and_made_printable() -> None:
    """A frame's name of 5 MB was published once a second."""
    monitor = Monitor("probe", "0", "1")
    monitor.turn(Condition(Health.STATUS_OK, "frame \x1b[2J" + "x" * 5_000_000, {}))
    detail = monitor.message().detail
    assert detail.startswith("frame ?[2J")
    assert len(detail) < 3000


def test_the_sum_of_ages_does_not_fall_where_a_clock_is_ahead() -> None:
    monitor = Monitor("probe", "r7", "1.2.3")
    monitor.dealt_with("scan", time.time_ns() + 60_000_000_000)
    assert monitor.lag.sums["scan"] == 0.0


def test_prometheus_reads_the_metrics() -> None:
    monitor = Monitor("probe", "r7", "1.2.3")
    monitor.turn(OK)
    monitor.handled("scan", 0.003)
    stamp = time.time_ns() - 3_000_000_000
    monitor.dealt_with("scan", stamp)
    oldest = (time.time_ns() - stamp) * 1e-9
    text = Metrics(monitor).text().decode()
    families = {family.name: family for family in text_string_to_metric_families(text)}
    assert [
        (sample.name, sample.labels, sample.value) for sample in families["eigenscan_messages"].samples
    ] == [("eigenscan_messages_total", {"what": "heard"}, 3.0)]
    assert families["eigenscan_status"].samples[0].value == Health.STATUS_OK
    assert families["eigenscan_handling_seconds"].type == "histogram"
    (age,) = (one.value for one in families["eigenscan_lag_seconds"].samples if one.name.endswith("_sum"))
    assert 3.0 <= age <= oldest
    assert families["eigenscan_waiting_messages"].samples[0].value == 2
    levels = families["eigenscan_level"]
    assert levels.type == "gauge"
    assert [(one.labels["what"], one.value) for one in levels.samples] == [("regions", 7)]
    (info,) = (
        families["eigenscan_info"].samples if "eigenscan_info" in families else families["eigenscan"].samples
    )
    assert info.labels["instance"] == "r7"


def test_the_contract_names_each_counter_that_may_fall() -> None:
    page = (ROOT / "docs/contract.md").read_text(encoding="utf-8")
    (stated,) = (line for line in page.splitlines() if line.startswith("`counters` only grow, except "))
    assert set(re.findall("`([a-z_]+)`", stated.split(". ")[0])) - {"counters"} == LEVELS


def test_a_port_that_is_taken_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(
            SettingsError, match=rf"metrics_port = {port}: cannot listen on 127.0.0.1: .*choose another"
        ):
            Monitor("probe", "0", "").serve("127.0.0.1", port)


def test_it_asks_no_name_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot without a link would wait for that, and its service would start late."""
    asked: list[str] = []

    def getfqdn(name: str = "") -> str:
        asked.append(name)
        return name

    monkeypatch.setattr(socket, "getfqdn", getfqdn)
    monitor = Monitor("probe", "0", "")
    assert monitor.serve("0.0.0.0", 0) > 0
    monitor.close()
    assert asked == []


def test_it_listens_on_an_address_of_ipv6() -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6")
    monitor = Monitor("probe", "0", "")
    monitor.turn(OK)
    port = monitor.serve("::1", 0)
    with urlopen(f"http://[::1]:{port}/healthz", timeout=120) as reply:
        assert reply.status == 200
    monitor.close()


def test_it_serves_while_a_client_hangs() -> None:
    monitor = Monitor("probe", "0", "")
    monitor.turn(OK)
    port = monitor.serve("127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", port)) as idle:
        idle.send(b"GET /metr")
        with urlopen(f"http://127.0.0.1:{port}/healthz", timeout=120) as reply:
            assert reply.status == 200
    monitor.close()
