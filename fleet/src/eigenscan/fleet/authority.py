"""A site's certificate authority, and the certificates that it signs.

Profile: RFC 5280; ECDSA on P-256 with SHA-256. Only the router's certificate may serve, the others are for
clients: a robot's cannot pass itself off as the site's router.
"""

from __future__ import annotations

import ipaddress
import os
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from eigenscan.runtime.errors import UsageError

try:
    from cryptography import x509
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
except ModuleNotFoundError as error:
    raise UsageError("certificates need cryptography: pip install 'eigenscan[fleet]'") from error

AUTHORITY_DAYS = 3650
SLOW_CLOCK = timedelta(days=1)
"""Certificates are valid from this long before now, for machines with a slow clock."""
LONGEST_NAME = 64
"""Longest common name (RFC 5280, ub-common-name)."""


PUT_BACK = "put it back from a copy; else make a fleet in a new folder"


@dataclass(frozen=True)
class Authority:
    """Signs certificates for one site. Its key can sign any: keep it off robots and servers."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @staticmethod
    def create(site: str) -> Authority:
        """A new one."""
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name(f"{site} fleet")
        usage = x509.KeyUsage(
            key_cert_sign=True, crl_sign=True, digital_signature=False, content_commitment=False,
            key_encipherment=False, data_encipherment=False, key_agreement=False, encipher_only=False,
            decipher_only=False,
        )  # fmt: skip
        certificate = (
            _builder(name, name, key.public_key(), AUTHORITY_DAYS)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(usage, critical=True)
            .sign(key, hashes.SHA256())
        )
        return Authority(certificate, key)

    @staticmethod
    def load(folder: Path) -> Authority:
        """Reads what `save` wrote. Raises UsageError that names the bad file."""
        for path in (folder / "ca.key", folder / "ca.crt"):
            if not path.exists():
                raise UsageError(f"{path}: is not there: {PUT_BACK}")
        try:
            key = serialization.load_pem_private_key((folder / "ca.key").read_bytes(), password=None)
        except (ValueError, TypeError, UnsupportedAlgorithm) as error:  # TypeError: it has a password
            raise UsageError(f"{folder / 'ca.key'}: is no key that can be read: {PUT_BACK}") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise UsageError(
                f"{folder / 'ca.key'}: is no elliptic curve key: give the folder that certify made"
            )
        return Authority(read_certificate(folder / "ca.crt"), key)

    def save(self, folder: Path) -> None:
        """Writes ca.crt and, for its owner only, ca.key."""
        write_pair(folder, "ca", self.certificate, self.key)

    def issue(self, folder: Path, name: str, identity: str, days: int, serves: Sequence[str] = ()) -> None:
        """Writes name.crt and name.key of a new key to `folder`, and the authority's certificate beside them.

        `identity` begins the common name; a random part behind it distinguishes certificates of one holder.
        `serves`: host names and addresses of a router; without any, the certificate is a client's.
        """
        key = ec.generate_private_key(ec.SECP256R1())
        subject = _name(f"{identity}.{secrets.token_hex(4)}")
        use = ExtendedKeyUsageOID.SERVER_AUTH if serves else ExtendedKeyUsageOID.CLIENT_AUTH
        builder = (
            _builder(subject, self.certificate.subject, key.public_key(), days)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(x509.ExtendedKeyUsage([use]), critical=True)
        )
        if serves:
            names = x509.SubjectAlternativeName([_served(host) for host in serves])
            builder = builder.add_extension(names, critical=False)
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "ca.crt", _pem(self.certificate), 0o644)
        write_pair(folder, name, builder.sign(self.key, hashes.SHA256()), key)


def read_certificate(path: Path) -> x509.Certificate:
    """Reads the certificate at `path`. Raises UsageError if it is none."""
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except ValueError as error:
        raise UsageError(f"{path}: is no certificate: put it back from a copy") from error


def common_name(path: Path) -> str:
    """Whom the certificate in `path` is for, as access rules name it."""
    (name,) = read_certificate(path).subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(name.value)


def is_for(path: Path, host: str) -> bool:
    """Whether the certificate in `path` is a server's at this host name or address."""
    names = read_certificate(path).extensions.get_extension_for_class(x509.SubjectAlternativeName)
    return _served(host) in names.value


def write_pair(
    folder: Path, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey
) -> None:
    """Writes name.crt, and name.key readable by its owner only: both or none.

    Raises UsageError if one exists.
    """
    folder.mkdir(parents=True, exist_ok=True)
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    _write_new(folder / f"{name}.key", private, 0o600)
    try:
        _write_new(folder / f"{name}.crt", _pem(certificate), 0o644)
    except (OSError, UsageError):
        (folder / f"{name}.key").unlink()
        raise


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _write_new(path: Path, content: bytes, mode: int) -> None:
    if path.name != "ca.crt" and path.exists():
        other = path.with_suffix(".key" if path.suffix == ".crt" else ".crt")
        raise UsageError(
            f"{path}: is there already: put back what is gone, {other.name} or fleet.toml, or move it away"
        )
    write_whole(path, content, mode)


def write_whole(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Writes a file whole or not at all; errors name it.

    An empty certificate on a full disk would count as one, and a router could read half a configuration. Whom
    `mode` shuts out never reads any of it.
    """
    new = path.with_name(f"{path.name}.new")
    new.unlink(missing_ok=True)
    try:
        with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            file.write(content)
        new.replace(path)
    except OSError as error:
        new.unlink(missing_ok=True)
        error.filename = str(path)
        raise


def _name(text: str) -> x509.Name:
    if len(text.encode()) > LONGEST_NAME:
        raise UsageError(
            f"{text}: too long by {len(text.encode()) - LONGEST_NAME} bytes for a certificate: shorten it"
        )
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _served(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - SLOW_CLOCK)
        .not_valid_after(now + timedelta(days=days))
    )
