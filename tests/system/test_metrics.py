"""Alerts and dashboard by Prometheus itself, on a site of real services."""

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.environment import PROGRAMS, ROOT
from tests.network import free_port
from tests.system.house import PATIENCE_S, House
from tests.system.prometheus import find_programs, serving, until_it_has
from tests.system.robot import Robot

pytestmark = pytest.mark.slow

DEPLOY = ROOT / "deploy"
ALERTS = DEPLOY / "prometheus/alerts.yml"
ONLY_IN_TROUBLE = re.compile(r"> 0$")
"""A graph that is empty on a site that is well."""


@pytest.fixture(scope="session")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return find_programs(tmp_path_factory.mktemp("prometheus"))


def expressions() -> list[str]:
    """Of the dashboard, and the metrics that the alerts are on."""
    dashboard = json.loads((DEPLOY / "grafana/eigenscan.json").read_text())
    graphs = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    rules = [
        rule["expr"] for group in yaml.safe_load(ALERTS.read_text())["groups"] for rule in group["rules"]
    ]
    metrics = {name for rule in rules for name in re.findall(r"\beigenscan_\w+", rule)}
    assert len(graphs) >= 10
    assert len(rules) >= 10
    return [expression for expression in graphs if not ONLY_IN_TROUBLE.search(expression)] + sorted(metrics)


def metrics_of(log: Path) -> str:
    """The address that a service states it serves its metrics on."""
    (url,) = re.findall(r"(http://\S+:\d+)/metrics", log.read_text())
    return str(url).removeprefix("http://")


def test_every_expression_finds_something_on_a_site_at_work(
    house: House, programs: Path, tmp_path: Path
) -> None:
    robot = Robot(house.site, house.config)
    house.start("mapbuilder", "--map", robot.write_map(house.logs), "--step", "1.0")
    for service in ("projector", "tracker", "scan-ingest"):
        house.start(service, "--metrics-port", 0)
    with (
        subprocess.Popen(
            [
                PROGRAMS / "eigenscan",
                "fleet",
                "metrics",
                "--site",
                house.site,
                "--zenoh",
                house.config,
                "--port",
                "0",
            ],
            stdout=subprocess.PIPE,
            text=True,
        ) as exporter,
        robot,
    ):
        assert exporter.stdout is not None
        site = exporter.stdout.readline().strip().removeprefix("http://").removesuffix("/metrics")
        services = [
            metrics_of(house.logs / f"{name}.log") for name in ("projector", "tracker", "scan-ingest")
        ]
        config = tmp_path / "prometheus.yml"
        jobs = {"site": [site], "services": services}
        config.write_text(
            json.dumps(
                {
                    "global": {"scrape_interval": "1s", "evaluation_interval": "1s"},
                    "rule_files": [str(ALERTS)],
                    "scrape_configs": [
                        {"job_name": name, "static_configs": [{"targets": targets}]}
                        for name, targets in jobs.items()
                    ],
                }
            )
        )
        with serving(programs, config, free_port()) as address:
            for expression in expressions():
                assert until_it_has(address, expression), expression
            (state,) = until_it_has(address, 'eigenscan_robot_state{robot="robot"} == 3')
            assert state["metric"]["job"] == "site"
            house.kill("tracker")
            (gone,) = until_it_has(address, "eigenscan_service_up == 0")
            assert gone["metric"]["service"] == "tracker"
            (pending,) = until_it_has(address, 'ALERTS{alertname="ServiceGone"}')
            assert pending["metric"]["service_instance"] == "robot"
        exporter.terminate()
        assert exporter.wait(PATIENCE_S) == 0


def cases() -> list[Any]:
    return list(yaml.safe_load((Path(__file__).parent / "alert_cases.yml").read_text()))


@pytest.mark.parametrize("case", cases(), ids=lambda case: case["alert"])
def test_each_alert_fires_in_trouble_and_not_without(
    programs: Path, tmp_path: Path, case: dict[str, Any]
) -> None:
    alert = case["alert"]
    for name, fires in (("trouble", True), ("well", False)):
        query = f'count(ALERTS{{alertname="{alert}", alertstate="firing"}}) or vector(0)'
        check = {"expr": query, "eval_time": "9m", "exp_samples": [{"labels": "{}", "value": int(fires)}]}
        inputs = [{"series": key, "values": values} for key, values in case[name].items()]
        tests: list[dict[str, Any]] = [
            {"interval": "15s", "input_series": inputs, "promql_expr_test": [check]}
        ]
        path = tmp_path / f"{name}.yml"
        path.write_text(
            json.dumps({"rule_files": [str(ALERTS)], "evaluation_interval": "15s", "tests": tests})
        )
        done = subprocess.run(
            [programs / "promtool", "test", "rules", path], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{alert} in {name}\n{done.stdout}{done.stderr}"


def test_every_alert_has_a_case() -> None:
    groups = yaml.safe_load(ALERTS.read_text())["groups"]
    assert {rule["alert"] for group in groups for rule in group["rules"]} == {
        case["alert"] for case in cases()
    }
