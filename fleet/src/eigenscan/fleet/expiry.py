"""Certificates that a Zenoh configuration names and that end soon: the links end with them."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from eigenscan.fleet.authority import read_certificate
from eigenscan.fleet.diagnosis import Finding
from eigenscan.runtime.certificates import TLS
from eigenscan.runtime.configured import stated
from eigenscan.runtime.errors import UsageError

SOON = timedelta(days=30)
"""Time to renew the certificates of a site."""

_NAMED = ("connect_certificate", "listen_certificate", "root_ca_certificate")


def of_certificates(config: Path, now: datetime | None = None) -> Iterator[Finding]:
    """A finding for each certificate that has ended, or does within SOON."""
    now = now or datetime.now(UTC)
    tls = stated(config, TLS) or {}
    for path in (Path(tls[name]) for name in _NAMED if tls.get(name)):
        try:
            end = read_certificate(path).not_valid_after_utc
        except (OSError, UsageError) as error:
            yield Finding("certificate", f"{path} cannot be read: {error}", f"correct it in {config}")
            continue
        if end < now + SOON:
            word = "expired" if end < now else "expires"
            yield Finding(
                "certificate",
                f"{path} {word} on {end:%Y-%m-%d}",
                "renew it (docs/fleet.md): without it nobody answers",
            )
