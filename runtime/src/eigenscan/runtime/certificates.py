"""The certificates that a Zenoh configuration names, and why another machine would refuse them.

Zenoh tries for ever to open a link with a certificate that is refused, and logs no reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eigenscan.runtime.configured import stated
from eigenscan.schemas.channels import ContractError

if TYPE_CHECKING:
    from ssl import SSLContext

TLS = "transport/link/tls"
"""Key of a Zenoh configuration."""
AUTHORITY = "root_ca_certificate"
SIDES = ("connect", "listen")
"""What a session does with a certificate: each side has a certificate and a private key of its own."""
RENEW = "renew it (docs/fleet.md)"
COPY_AGAIN = "copy this machine's folder again (docs/fleet.md)"

_WORDS = {
    9: "is not valid yet, or {ca} is not: set this machine's clock",
    10: f"has expired, or {{ca}} has: {RENEW}",
    26: f"may not be used for this (a robot's serves no router): {COPY_AGAIN}",
}
"""By X509_V_ERR codes of OpenSSL: CERT_NOT_YET_VALID, CERT_HAS_EXPIRED, INVALID_PURPOSE."""
_FOREIGN = f"is not signed by the authority in {{ca}}: {COPY_AGAIN}"


def check_readable(path: Path | None, tls: Mapping[str, Any]) -> None:
    """Raises ContractError that names a certificate or key that cannot be read: Zenoh names none."""
    for field, file in tls.items():
        if not (file and field.endswith(("_certificate", "_private_key"))):
            continue
        try:
            Path(file).read_bytes()
        except OSError as error:
            raise ContractError(
                f"{path}: {field} = {file!r}: cannot be read: {error.strerror}: "
                "copy the certificates there, or correct the path"
            ) from error


def fault_in(path: Path | None) -> str:
    """`fault_of` the certificates that the configuration at `path` names; empty if it names none."""
    return fault_of(stated(path, TLS) or {})


def fault_of(tls: Mapping[str, Any]) -> str:
    """Why certificates open no link, as a handshake in memory finds it; empty if they do.

    The holder shows each to one who trusts only the named authority, as RFC 8446 has it. It cannot tell
    whether the other machine trusts that authority too.
    """
    for side in SIDES:
        named = (tls.get(f"{side}_certificate"), tls.get(f"{side}_private_key"), tls.get(AUTHORITY))
        if all(named) and (fault := _fault_of_one(side, *map(str, named))):
            return fault
    return ""


def _fault_of_one(side: str, certificate: str, key: str, ca: str) -> str:
    import ssl  # rarely needed: a robot's services have no certificate

    connects = side == "connect"
    holder = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT if connects else ssl.PROTOCOL_TLS_SERVER)
    other = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if connects else ssl.PROTOCOL_TLS_CLIENT)
    for context in (holder, other):
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        for context in (holder, other):  # a server must show one in any case
            context.load_cert_chain(certificate, key, password=lambda: b"")
    except (OSError, ValueError) as error:
        if isinstance(error, ssl.SSLError) and error.reason == "KEY_VALUES_MISMATCH":
            return f"{key} is not the key of {certificate}: {COPY_AGAIN}"
        return f"{certificate} or {key} is damaged: {COPY_AGAIN}"
    try:
        other.load_verify_locations(ca)
    except (OSError, ValueError) as error:
        return f"{ca} is no certificate: {_short(error)}: {COPY_AGAIN}"
    other.verify_mode = ssl.CERT_REQUIRED
    server, client = (other, holder) if connects else (holder, other)
    try:
        _shake_hands(server, client)
    except ssl.SSLCertVerificationError as error:
        return f"{certificate} {_WORDS.get(error.verify_code, _FOREIGN).format(ca=ca)}"
    except ssl.SSLError as error:
        return f"{certificate} cannot be used: {_short(error)}: {COPY_AGAIN}"
    return ""


def _short(error: Exception) -> str:
    reason = getattr(error, "reason", None)
    return reason.replace("_", " ").lower() if reason else str(getattr(error, "strerror", None) or error)


def _shake_hands(server: SSLContext, client: SSLContext) -> None:
    """A TLS handshake without a network. Raises ssl.SSLError from whoever refuses."""
    import ssl

    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = (
        client.wrap_bio(to_client, to_server),
        server.wrap_bio(to_server, to_client, server_side=True),
    )
    open_ends = set(ends)
    while open_ends:
        for end in ends:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
            open_ends.discard(end)
