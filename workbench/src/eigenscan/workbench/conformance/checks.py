"""The checks of a run, each with its clause of docs/contract.md."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
from eigenscan.schemas.channels import HEALTH, HYPOTHESES, LATCHED_TEMPLATE, MODEL_SET
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.wire import encode
from eigenscan.workbench.conformance.check import FAILED, PASSED, Check, check, skipped
from eigenscan.workbench.conformance.receiving import alive_key
from eigenscan.workbench.conformance.recording import as_ours
from eigenscan.workbench.conformance.travelling import travelling
from eigenscan.workbench.conformance.trial import Observed
from eigenscan.workbench.conformance.values import faults

STOPS_WITHIN_S = 2.0
HEALTH_GAP_S = 2.5
"""Health comes once a second; a busy machine may be late by as much again."""


def judge(seen: Observed, latency_s: float, patience: float = 1.0) -> list[Check]:
    """All checks. `latency_s`: limit for 95 % of the answers; `patience`: factor on the other limits."""
    first, last = [*_presence(seen, patience)], _stops(seen, patience)
    if seen.profile.records:
        others = [*travelling(seen), *_survives(seen), *seen.kept, last]
    else:
        others = [*(one for part in _PARTS for one in part(seen)), _latency(seen, latency_s), last]
    if seen.ended_early and not seen.tokens and not seen.received:
        return [
            first[0],
            *(skipped(one.name, one.clause, "it does not start") for one in [*first[1:], *others]),
        ]
    if seen.received or seen.profile.records:
        return [*first, *others]
    return [
        skipped(one.name, one.clause, "it publishes nothing") if one.result == PASSED else one
        for one in [*first, *others]
    ]


def _presence(seen: Observed, patience: float) -> Iterator[Check]:
    key = alive_key(seen.address["site"], seen.profile.name, seen.instance)
    clause = "Presence"
    if key in seen.tokens:
        waited = seen.tokens[key][0] - seen.started_at
        yield Check("presence", clause, PASSED, f"its liveliness token came after {waited:.1f} s")
    else:
        others = sorted(token for token in seen.tokens if "/latched/" not in token)
        held = f", only {', '.join(others)}" if others else ""
        lives = f"; {seen.ended_early}" if seen.ended_early else ""
        yield Check("presence", clause, FAILED, f"no liveliness token on {key}{held}{lives}")
    healths = [one for one in seen.received if one.channel is HEALTH]
    if not healths:
        yield Check("health", "Health", FAILED, "it never publishes eigenscan.Health")
        return
    end = seen.stopped_at - (seen.stopped[1] if seen.stopped else 0.0) if seen.stopped else healths[-1].at
    gaps = np.diff([one.at for one in healths if one.at <= end] + [end])
    problems = []
    if len(gaps) and gaps.max() > HEALTH_GAP_S * patience:
        problems.append(f"silent for {gaps.max():.1f} s, health is due once a second")
    named = {(one.address["service"], one.address["instance"]) for one in healths}
    if named != {(seen.profile.name, seen.instance)}:
        problems.append(f"it calls itself {sorted(named)}, not {seen.profile.name} {seen.instance}")
    if not seen.ready:
        newest = healths[-1].message
        detail = newest.detail if isinstance(newest, Health) else ""
        problems.append(f"it does not become ready: {detail or 'no detail'}")
    yield check(
        "health",
        "Health",
        problems,
        f"{len(healths)} messages, at most {max(gaps, default=0):.1f} s apart",
    )


def _answers(seen: Observed) -> Iterator[Check]:
    profile, clause = seen.profile, "Time, frames, numbers"
    if profile.asks is None:
        return
    if not seen.asked:
        yield Check("answers", clause, FAILED, "it was gone before it was asked anything")
        return
    published = Counter(
        (one.channel, one.stamp, one.address.get("lidar", ""))
        for one in seen.received
        if one.channel in profile.answers
    )
    missing, twice = [], []
    for due in sorted(seen.wanted, key=lambda one: one[1:]):
        channel, stamp, lidar = due
        where = f"{channel.name} {lidar} of {stamp / 1e9:.3f}"
        if not published[due]:
            missing.append(f"no {where}")
        elif published[due] > 1:
            twice.append(f"{published[due]} {where}")
    if missing:
        twice.insert(0, f"{len(missing)} of {len(seen.wanted)} answers are missing, the first: {missing[0]}")
    yield check("answers", clause, twice, f"one answer to each of {len(seen.asked)} {_asked(seen)}")
    yield check("order", clause, list(_disorder(seen)), "stamps of each key as those of what is answered")


def _disorder(seen: Observed) -> Iterator[str]:
    asked = {stamp for _, stamp in seen.asked}
    stamps = defaultdict(list)
    for one in seen.received:
        if one.channel in seen.profile.answers and one.stamp in asked:
            stamps[one.key].append(one.stamp)
    for key, order in stamps.items():
        for before, after in pairwise(order):
            if after < before:
                yield f"{key}: {after / 1e9:.3f} comes after {before / 1e9:.3f}"


def _values(seen: Observed) -> Iterator[Check]:
    problems = [
        f"{one.key} of {one.stamp / 1e9:.3f}: {fault}"
        for one in seen.received
        if one.message is not None
        for fault in faults(one.message)
    ]
    yield check("values", "Time, frames, numbers", problems, "every number is one that the contract allows")


def _models(seen: Observed) -> Iterator[Check]:
    name, clause = "late join", "Latched channels"
    if seen.profile.asks is None:
        yield _late_joiner(seen, name, clause)
        return
    if not seen.profile.latched:
        yield skipped(name, clause, f"a {seen.profile.name} receives no latched channel")
        return
    versions = [
        one.message.model_version
        for one in seen.received
        if one.channel is HYPOTHESES and isinstance(one.message, Hypotheses)
    ]
    problems = []
    first = {one.open(ModelSet).version for one in seen.vectors.latched if one.channel is MODEL_SET}
    if not versions:
        problems.append(
            "no answer: the models that were published before its start did not come, or it has none"
        )
    elif first.isdisjoint(versions):
        problems.append("model_version of its answers is never that of the set published before its start")
    yield check(name, clause, problems, "has the models that were published before its start")
    is_taken = seen.other_set and versions and versions[-1] == seen.other_set
    problems = [] if is_taken else ["it does not go on with the newer set"]
    yield check("other models", "Models", problems, "takes a newer set while it runs")


def _late_joiner(seen: Observed, name: str, clause: str) -> Check:
    site = seen.address["site"]
    published = {
        one.key: encode(one.message)
        for one in seen.received
        if one.message is not None and one.channel in seen.profile.outputs
    }
    problems = []
    for channel in seen.profile.outputs:
        start = LATCHED_TEMPLATE.format(site=site, channel=channel.name, session="")
        if not any(token.startswith(start) for token in seen.tokens):
            problems.append(f"no liveliness token on {start}{{session}}")
        if not any(one is channel for one, _ in seen.joined.values()):
            problems.append(f"who comes late gets no {channel.name}: is it answered by a queryable?")
    for key, payload in published.items():
        if key not in seen.joined:
            problems.append(f"{key}: a late subscriber does not receive it")
        elif as_ours(*seen.joined[key]) != payload:
            problems.append(f"{key}: a late subscriber receives another message")
    return check(name, clause, problems, f"who comes late gets the same {len(seen.joined)} messages")


def _bad_input(seen: Observed) -> Iterator[Check]:
    clause = "Samples"
    if seen.profile.asks is None:
        yield skipped("bad input", clause, f"a {seen.profile.name} has no input")
        return
    yield from _survives(seen)
    if seen.ended_early:
        yield Check("recovers", clause, FAILED, "it is gone")
        return
    answered = {one.stamp for one in seen.received if one.channel in seen.profile.answers}
    left = [stamp for _, stamp in seen.asked_again if stamp not in answered]
    silent = [f"{len(left)} of {len(seen.asked_again)} {_asked(seen)} after the nonsense get no answer"]
    words = f"answers the {len(seen.asked_again)} {_asked(seen)} after that"
    yield check("recovers", clause, silent if left or not seen.asked_again else [], words)


def _survives(seen: Observed) -> Iterator[Check]:
    """Whether it lives through bad input, and counts it."""
    clause = "Samples"
    if seen.ended_early:
        yield Check("bad input", clause, FAILED, seen.ended_early)
        yield Check("counted", "Health", FAILED, "it is gone")
        return
    lives = f"lives through {seen.undecodable} samples that do not decode, and others"
    yield Check("bad input", clause, PASSED, lives)
    counted = seen.counted - seen.counted_before
    short = [f"counter undecodable grew by {counted}, not by {seen.undecodable}"]
    yield check(
        "counted", "Health", short if counted < seen.undecodable else [], f"{counted} counted as undecodable"
    )


def _asked(seen: Observed) -> str:
    return f"{seen.profile.asks.name} messages" if seen.profile.asks else ""


def _numbers(seen: Observed) -> Iterator[Check]:
    if seen.profile.numbers is None:
        return
    problems, words = seen.profile.numbers(seen.received, seen.vectors)
    if not problems and words.startswith("0 "):
        problems = ["none of its answers can be compared with the reference"]
    yield check("numbers", "Time, frames, numbers", problems, words)


def _latency(seen: Observed, limit_s: float) -> Check:
    name, clause = "latency", "Quality of service"
    if seen.profile.asks is None:
        return skipped(name, clause, f"a {seen.profile.name} is asked nothing")
    asked: dict[int, float] = {}
    for (_, stamp), at in seen.asked.items():
        asked.setdefault(stamp, at)
    took = [
        one.at - asked[one.stamp]
        for one in seen.received
        if one.channel in seen.profile.answers and one.stamp in asked
    ]
    if not took:
        return Check(name, clause, FAILED, "no answer to measure")
    middle, most = np.percentile(took, [50, 95]) * 1e3
    words = f"median {middle:.0f} ms, 95 % within {most:.0f} ms"
    return check(
        name, clause, [f"{words}, asked for {limit_s * 1e3:.0f} ms"] if most > limit_s * 1e3 else [], words
    )


def _stops(seen: Observed, patience: float) -> Check:
    name, clause = "stops", "Presence"
    if seen.stopped is None:
        return Check(name, clause, FAILED, seen.ended_early or "it is gone")
    code, took = seen.stopped
    key = alive_key(seen.address["site"], seen.profile.name, seen.instance)
    problems = []
    if code is None:
        problems.append(f"SIGTERM does not end it; killed after {took:.0f} s")
    elif took > STOPS_WITHIN_S * patience:
        problems.append(f"takes {took:.1f} s to end after SIGTERM, the contract has {STOPS_WITHIN_S:.0f} s")
    elif key in seen.tokens and seen.tokens[key][1] is None:
        problems.append("its liveliness token is still there after its end")
    return check(name, clause, problems, f"ends {took:.1f} s after SIGTERM")


_PARTS: tuple[Callable[[Observed], Iterator[Check]], ...] = (
    travelling,
    _models,
    _answers,
    _values,
    _numbers,
    _bad_input,
)
