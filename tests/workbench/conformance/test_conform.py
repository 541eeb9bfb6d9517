"""`eigenscan conform` over real Zenoh: our services pass; each wrong one fails at what is wrong with it."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from tests.environment import PROGRAMS

pytestmark = pytest.mark.slow

ODD_INGEST = Path(__file__).parent / "odd_ingest.py"
AT_ONCE = 5
"""Runs mostly wait for their drive."""
ODD_RECORDER = Path(__file__).parent / "odd_recorder.py"
OURS = ("scan-ingest", "projector", "tracker", "mapbuilder")

# fault: the checks that must fail for it, and words that one of them must report
FAULTS = {
    "other-key": (["keys", "answers"], "is no key of the contract"),
    "other-schema": (["schema", "answers"], "eigenscan.Scan/2"),
    "other-qos": (["qos"], "priority DATA, the contract has REAL_TIME"),
    "dies-on-garbage": (
        ["bad input"],
        "ended with code 3: cannot decode, goodbye (after ",
    ),
    "no-liveliness": (["presence"], "no liveliness token on"),
    "arrival-time": (["answers"], "48 of 48 answers are missing"),
    "metres-off": (["numbers"], "] is "),
    "slow": (["latency"], "asked for 30 ms"),
    "miscounts": (["counted"], "counter undecodable grew by 0, not by 12"),
    "deaf-to-sigterm": (["stops"], "SIGTERM does not end it"),
}
# of the odd recorder: the check that must fail, and words that it must report
RECORDING_FAULTS = {
    "no-past": ("kept", "that was published before its start, 1 are lost"),
    "loses-some": ("kept", "are lost, changed or out of order"),
    "changes-poses": ("kept", "/pose: of "),
    "arrival-as-stamp": ("times", "the stamp is "),
    "never-flushes": ("crash", "after a kill: "),
}


@dataclass(frozen=True)
class Ended:
    """How `eigenscan conform` ended, and what it wrote."""

    code: int
    out: str
    err: str
    checks: dict[str, tuple[str, str]]
    junit: Path


def conform(folder: Path, name: str, service: str, command: Sequence[object], *flags: object) -> Ended:
    results, junit = folder / f"{name}.json", folder / f"{name}.xml"
    options = ["--json", results, "--junit", junit, *flags]
    done = subprocess.run(
        [str(word) for word in (PROGRAMS / "eigenscan", "conform", service, *options, "--", *command)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    checks = {}
    if results.exists():
        checks = {c["name"]: (c["result"], c["words"]) for c in json.loads(results.read_text())["checks"]}
    return Ended(done.returncode, done.stdout, done.stderr, checks, junit)


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ended]:
    """All runs of this module, some at a time: of our services, and of the odd one with each fault."""
    folder = tmp_path_factory.mktemp("conform")
    # what is wrong is waited for, for longer the more patient
    patient, wrong = (("--latency", 60, "--start", 240, "--patience", times) for times in (10, 4))
    runs: dict[str, tuple[Any, ...]] = {
        service: (service, [PROGRAMS / f"eigenscan-{service}"], *patient) for service in OURS
    }
    for fault in ("none", *FAULTS):
        limits = patient if fault == "none" else wrong
        latency = ("--latency", 0.03) if fault == "slow" else ()
        runs[fault] = ("scan-ingest", [sys.executable, ODD_INGEST, fault], *limits, *latency)
    runs["recorder"] = (
        *("recorder", [PROGRAMS / "eigenscan-recorder", "--mcap", "{recording}", "--rotate-mb", "0.05"]),
        *patient,
    )
    for fault in ("none", *RECORDING_FAULTS):
        runs[f"recorder {fault}"] = (
            "recorder",
            [sys.executable, ODD_RECORDER, fault],
            *(patient if fault == "none" else wrong),
        )
    with ThreadPoolExecutor(AT_ONCE) as pool:
        futures = {name: pool.submit(conform, folder, name, *run) for name, run in runs.items()}
    return {name: future.result() for name, future in futures.items()}


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", [*OURS, "recorder", "none", "recorder none"])
def test_what_is_right_conforms(ended: dict[str, Ended], name: str) -> None:
    run = ended[name]
    assert run.code == 0, run.out + run.err
    assert "conforms to" in run.out.splitlines()[-1]
    assert "FAILED" not in run.out
    assert [check for check, (result, _) in run.checks.items() if result == "ok"], run.out
    assert len(run.checks) >= 11


def test_our_recorder_was_seen_to_rotate(ended: dict[str, Ended]) -> None:
    result, words = ended["recorder"].checks["rotation"]
    assert result == "ok", words


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("fault", RECORDING_FAULTS)
def test_a_wrong_recorder_fails_at_that_clause_alone(ended: dict[str, Ended], fault: str) -> None:
    check, words = RECORDING_FAULTS[fault]
    run = ended[f"recorder {fault}"]
    assert run.code == 1, run.out + run.err
    failed = {name: published for name, (result, published) in run.checks.items() if result == "FAILED"}
    assert check in failed, run.out
    assert failed.keys() <= {check, "crash"}, run.out
    assert words in failed[check]
    (line,) = [line for line in run.out.splitlines() if words in line and f" {check} " in line]
    assert line.endswith("[docs/contract.md, Recordings]")


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_fails_at_that_and_reports_it(ended: dict[str, Ended], fault: str) -> None:
    checks, words = FAULTS[fault]
    run = ended[fault]
    assert run.code == 1, run.out + run.err
    failed = {check: published for check, (result, published) in run.checks.items() if result == "FAILED"}
    assert set(checks) <= set(failed), run.out
    assert any(words in failed[check] for check in checks), run.out
    assert "[docs/contract.md, " in run.out
    assert run.err.startswith("eigenscan conform: ")
    assert checks[0] in run.err
    root = ElementTree.parse(run.junit).getroot()
    assert {case.get("name") for case in root.iter("testcase") if case.find("failure") is not None} == set(
        failed
    )


def test_what_is_right_otherwise_fails_at_nothing_else(ended: dict[str, Ended]) -> None:
    for fault in ("other-qos", "no-liveliness", "slow", "miscounts", "deaf-to-sigterm", "metres-off"):
        failed = [check for check, (result, _) in ended[fault].checks.items() if result == "FAILED"]
        assert failed == FAULTS[fault][0], ended[fault].out


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (
            ("nothing", "--", "true"),
            2,
            "nothing: choose one of scan-ingest, projector, tracker, mapbuilder, recorder",
        ),
        (("tracker", "--", "no-such-program"), 2, "no-such-program: is no program that can be started"),
        (("projector", "--", "no-such-program"), 2, "no-such-program: is no program that can be started"),
        (("tracker", "--", "false"), 1, "does not conform to tracker: presence"),
    ],
)
def test_what_cannot_be_judged(arguments: tuple[str, ...], code: int, words: str) -> None:
    done = subprocess.run(
        [PROGRAMS / "eigenscan", "conform", *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    assert words in done.stderr
    assert "\nok " not in f"\n{done.stdout}"
    assert len(done.stderr.splitlines()) == 1
