"""Self-signed certificate of the service, created if missing and renewed before it expires."""

from __future__ import annotations

import ipaddress
import os
import socket
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

#: Browsers take no certificate that is good for longer.
GOOD_FOR = timedelta(days=825)
#: It is made anew at a start so long before its end.
RENEWED = timedelta(days=60)


def own_certificate(folder: Path, address: str, now: datetime | None = None) -> tuple[Path, Path]:
    """Return certificate and key (PEM) in a folder; makes them where they are missing or old.

    Parameters
    ----------
    folder : Path
        Where the service keeps what is its own.
    address : str
        That it listens at; the certificate also names this computer.
    now : datetime, optional
        Default: now.
    """
    certificate, key = folder / "http_certificate.pem", folder / "http_key.pem"
    now = now or datetime.now(UTC)
    names = _names(address)
    if not (key.is_file() and certificate.is_file() and _good(certificate, names, now)):
        folder.mkdir(parents=True, exist_ok=True)
        _make(certificate, key, names, now)
    return certificate, key


def _names(address: str) -> list[x509.GeneralName]:
    hosts = dict.fromkeys(["localhost", socket.gethostname(), "127.0.0.1", "::1", address])
    names: list[x509.GeneralName] = []
    for host in hosts:
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(host)))
        except ValueError:
            names.append(x509.DNSName(host))
    return names


def _good(path: Path, names: list[x509.GeneralName], now: datetime) -> bool:
    try:
        certificate = x509.load_pem_x509_certificate(path.read_bytes())
        named = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (ValueError, x509.ExtensionNotFound):
        return False
    return certificate.not_valid_after_utc - RENEWED > now and set(names) <= set(named)


def _make(certificate: Path, key: Path, names: list[x509.GeneralName], now: datetime) -> None:
    private = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "thermojoint")])
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(private.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + GOOD_FOR)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(private, hashes.SHA256())
    )
    _write_private(
        key,
        private.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        ),
    )
    _write_private(certificate, made.public_bytes(serialization.Encoding.PEM))


def _write_private(path: Path, content: bytes) -> None:
    """Write a file whole, which nobody but its owner can read at any moment."""
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(path)
    finally:
        Path(name).unlink(missing_ok=True)
