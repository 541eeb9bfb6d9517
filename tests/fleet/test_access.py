"""Every key of the contract, published and received by every role, through a router: as the table allows."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import pytest
import zenoh
from eigenscan.schemas.channels import (
    ALIVE_TEMPLATE,
    CHANNELS,
    CONTRACT_VERSION,
    HEALTH,
    LATCHED_TEMPLATE,
    MODEL,
    POSE,
    RELOCATION,
    SCAN,
    SCAN_RAW,
    Channel,
    Role,
)

from tests.fleet.conftest import ROBOTS, SITE, Fleet, make_fleet, until

SERVICES = tuple(role.value for role in Role if role is not Role.ROBOT)
HOLDERS = (*ROBOTS, *SERVICES)
ROUNDS, PAUSE_S, DENIED_S = 5, 0.05, 0.5
LATCHED = [channel for channel in CHANNELS if channel.qos.latched]


def role_of(holder: str) -> Role:
    return Role.ROBOT if holder in ROBOTS else Role(holder)


def key_of(channel: Channel, owner: str) -> str:
    """The channel's key that belongs to `owner`: its robot, or its instance."""
    fields = {
        "site": SITE,
        "robot": owner,
        "instance": owner,
        "lidar": "front",
        "projector": "p",
        "region": "hall",
        "kind": "ring8-180",
    }
    return channel.key(fields | {"service": "tracker" if owner in ROBOTS else owner})


def may_publish(holder: str, channel: Channel, owner: str) -> bool:
    role = role_of(holder)
    if role not in channel.published_by:
        return False
    by_owner = {"robot", "instance"} & set(channel.fields)
    if channel is RELOCATION and role is Role.OPERATOR:
        return True  # to any robot
    return channel.qos.air_hz > 0 and (holder == owner or not by_owner)


def may_receive(holder: str, channel: Channel, owner: str) -> bool:
    to_another = holder in ROBOTS and "robot" in channel.fields and holder != owner
    return role_of(holder) in channel.received_by and not to_another


@dataclass
class Exchange:
    """What everybody received, of whom, after everybody published everything."""

    received: set[tuple[str, str, str]] = field(default_factory=set)
    answered: set[tuple[str, str, str]] = field(default_factory=set)
    tokens: set[tuple[str, str]] = field(default_factory=set)

    def subscriber(self, holder: str) -> Any:
        def on_sample(sample: Any) -> None:
            published = sample.payload.to_bytes().decode(
                errors="replace"
            )  # the router publishes its health meanwhile
            self.received.add((holder, str(sample.key_expr), published))

        return on_sample

    def seer(self, holder: str) -> Any:
        return lambda token: self.tokens.add((holder, str(token.key_expr)))


def answerer(key: str, holder: str) -> Any:
    def answer(query: Any) -> None:
        with query:
            query.reply(key, holder)

    return answer


WHAT = [(channel, owner) for channel, owner in product(CHANNELS, HOLDERS)]
SPOKEN = [(holder, channel, owner) for holder, (channel, owner) in product(HOLDERS, WHAT)]


def speak(sessions: dict[str, zenoh.Session]) -> None:
    for holder, channel, owner in SPOKEN:
        sessions[holder].put(key_of(channel, owner), holder)


def token_of(holder: str, owner: str) -> str:
    """A sign of life under `owner`'s name, distinguished by who shows it."""
    service = "tracker" if owner in ROBOTS else owner
    return ALIVE_TEMPLATE.format(
        site=SITE, service=service, instance=owner, contract=f"{CONTRACT_VERSION}-{holder}"
    )


def ask(sessions: dict[str, zenoh.Session], reported: Exchange) -> set[tuple[str, str, str]]:
    """Everybody asks for what is latched; gives who was answered so far, with which key, by whom."""
    for holder, channel in product(HOLDERS, LATCHED):
        replies = sessions[holder].get(
            channel.selector({"site": SITE}), target=zenoh.QueryTarget.ALL, timeout=5.0,
            consolidation=zenoh.ConsolidationMode.NONE,
        )  # fmt: skip
        reported.answered |= {
            (holder, str(reply.ok.key_expr), reply.ok.payload.to_string()) for reply in replies if reply.ok
        }
    return reported.answered


def tokens_allowed() -> set[tuple[str, str]]:
    """Who sees which sign of life, where the table lets it."""
    seen = {
        (seer, token_of(holder, holder))
        for holder, seer in product(HOLDERS, SERVICES)
        if seer != holder and role_of(holder) in HEALTH.published_by
    }
    for channel, holder, seer in product(LATCHED, HOLDERS, HOLDERS):
        if seer != holder and role_of(holder) in channel.published_by:
            seen.add((seer, LATCHED_TEMPLATE.format(site=SITE, channel=channel.name, session=holder)))
    return seen


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """Without limits of rate: they would hold back what access control should."""
    fleet = make_fleet(tmp_path_factory.mktemp("access"))
    settings = fleet.folder / "fleet.toml"
    most = "pose = 1000.0\ntracks = 1000.0\nadvice = 1000.0"
    settings.write_text(settings.read_text().replace("scan = 2.0", most))
    fleet.command("configure")
    fleet.install("site")
    try:
        fleet.start("site")
        yield fleet
    finally:
        fleet.stop()


@pytest.fixture(scope="module")
def exchange(fleet: Fleet) -> Iterator[Exchange]:
    reported, shown = Exchange(), []
    with ExitStack() as opened:
        sessions = {
            holder: opened.enter_context(
                fleet.past_its_router(holder) if holder in ROBOTS else fleet.at_site(holder)
            )
            for holder in HOLDERS
        }
        for holder, session in sessions.items():
            # a rule is asked for the subscription as it stands: the whole, and each channel by itself
            for selector in ["**", f"{SITE}/**", *(channel.selector({"site": SITE}) for channel in CHANNELS)]:
                session.declare_subscriber(
                    selector, reported.subscriber(holder), allowed_origin=zenoh.Locality.REMOTE
                )
            session.liveliness().declare_subscriber(f"{SITE}/**", reported.seer(holder), history=True)
            for channel in LATCHED:
                selector = LATCHED_TEMPLATE.format(site=SITE, channel=channel.name, session="*")
                session.liveliness().declare_subscriber(selector, reported.seer(holder), history=True)
                token = LATCHED_TEMPLATE.format(site=SITE, channel=channel.name, session=holder)
                shown.append(session.liveliness().declare_token(token))
                session.declare_queryable(
                    channel.selector({"site": SITE}), answerer(key_of(channel, holder), holder)
                )
            shown += [session.liveliness().declare_token(token_of(holder, owner)) for owner in HOLDERS]
        expected = {
            (subscriber, key_of(channel, owner), holder)
            for holder, channel, owner in SPOKEN
            for subscriber in HOLDERS
            if subscriber != holder
            and may_publish(holder, channel, owner)
            and may_receive(subscriber, channel, owner)
        }

        def published() -> bool:
            speak(sessions)
            return expected <= reported.received

        until(published, "not all that is allowed has arrived")
        for _ in range(ROUNDS):
            speak(sessions)
            time.sleep(PAUSE_S)
        answers = {
            (subscriber, key_of(channel, holder), holder)
            for holder, channel, subscriber in product(HOLDERS, LATCHED, HOLDERS)
            if subscriber != holder
            and may_publish(holder, channel, holder)
            and may_receive(subscriber, channel, holder)
        }
        until(lambda: answers <= ask(sessions, reported), "not all that may answer do")
        until(lambda: tokens_allowed() <= reported.tokens, "not all signs of life that are allowed are seen")
        time.sleep(DENIED_S)
        assert len(shown) == len(HOLDERS) * (len(LATCHED) + len(HOLDERS))  # a token that nobody holds is gone
        yield reported


@pytest.mark.parametrize("holder", HOLDERS)
@pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.name)
def test_publishes_what_the_table_lets_it_publish(exchange: Exchange, channel: Channel, holder: str) -> None:
    for owner, subscriber in product(HOLDERS, HOLDERS):
        if subscriber != holder:
            arrived = (subscriber, key_of(channel, owner), holder) in exchange.received
            allowed = may_publish(holder, channel, owner) and may_receive(subscriber, channel, owner)
            assert arrived == allowed, f"{holder} as {owner} to {subscriber}"


@pytest.mark.parametrize("holder", HOLDERS)
@pytest.mark.parametrize("channel", LATCHED, ids=lambda channel: channel.name)
def test_asks_and_answers_where_the_table_lets_it(exchange: Exchange, channel: Channel, holder: str) -> None:
    asked = {(who, by) for who, key, by in exchange.answered if channel.parse(key) and who != by}
    assert {who for who, by in asked if by == holder} == {
        who
        for who in HOLDERS
        if who != holder and may_publish(holder, channel, holder) and may_receive(who, channel, holder)
    }


@pytest.mark.parametrize("holder", HOLDERS)
def test_shows_itself_under_its_own_name_only(exchange: Exchange, holder: str) -> None:
    for owner, seer in product(HOLDERS, HOLDERS):
        if seer != holder:
            seen = (seer, token_of(holder, owner)) in exchange.tokens
            speaks = holder == owner and role_of(holder) in HEALTH.published_by
            assert seen == (speaks and seer in SERVICES), f"{holder} as {owner} to {seer}"
    for channel in LATCHED:
        token = LATCHED_TEMPLATE.format(site=SITE, channel=channel.name, session=holder)
        seers = {seer for seer, seen in exchange.tokens if seen == token and seer != holder}
        assert seers == (set(HOLDERS) - {holder} if role_of(holder) in channel.published_by else set())


def test_a_robot_speaks_of_services_that_there_are(fleet: Fleet) -> None:
    """Made-up names would fill the site's recordings: each is one more channel of a file."""
    received: list[str] = []
    with fleet.past_its_router("r17") as robot, fleet.at_site("recorder") as recorder:
        recorder.declare_subscriber(f"{SITE}/health/**", lambda sample: received.append(str(sample.key_expr)))
        known = HEALTH.key({"site": SITE, "service": "tracker", "instance": "r17"})

        def known_is_received() -> bool:
            robot.put(f"{SITE}/health/made-up/r17", b"")
            robot.put(known, b"")
            return known in received

        until(known_is_received, "a known service is not heard")
        time.sleep(DENIED_S)
    assert f"{SITE}/health/made-up/r17" not in received


def test_what_a_reader_of_the_table_expects(exchange: Exchange) -> None:
    """Published once without the table, so that an error in it is noticed as well."""
    received_by: dict[tuple[str, str, str], set[str]] = {}
    received = exchange.received.copy()  # the router's health still comes
    for holder, channel, owner in SPOKEN:
        published = (key_of(channel, owner), holder)
        received_by[channel.name, owner, holder] = {
            one for one, *what in received if tuple(what) == published
        }
    site = {"mapbuilder", "recorder", "operator"}
    assert received_by[POSE.name, "r17", "r17"] == site
    assert received_by[POSE.name, "r17", "r18"] == set()
    assert received_by[POSE.name, "r17", "mapbuilder"] == set()
    assert received_by[SCAN.name, "r17", "r17"] == received_by[SCAN_RAW.name, "r17", "r17"] == set()
    assert received_by[MODEL.name, "mapbuilder", "mapbuilder"] == {"r17", "r18", "recorder", "operator"}
    assert received_by[MODEL.name, "r17", "r17"] == set()
    reported = {key: by for key, by in received_by.items() if key[2] == "operator" and by}
    assert reported[RELOCATION.name, "r17", "operator"] == {"r17", "mapbuilder", "recorder"}
    assert {channel for channel, _, _ in reported} == {RELOCATION.name}
    assert (
        received_by[RELOCATION.name, "r17", "mapbuilder"]
        == received_by[RELOCATION.name, "r17", "r18"]
        == set()
    )
