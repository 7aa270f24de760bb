"""Certificates of the service: from the settings, or its own, created when missing."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from thermojoint.artefacts.errors import InputError
from thermojoint.live.secret import create_private, refuse_open_to_others
from thermojoint.live.settings import Certified, HttpServer, OpcuaServer, ServiceFile
from thermojoint.live.trust_list import certificate_in, span_of

#: Application URI of the service in OPC UA.
APPLICATION = "urn:thermojoint:live"
#: Validity: a new one must be entered by hand in OPC UA clients; browsers limit its duration.
OPCUA_LASTS, HTTP_LASTS = timedelta(days=5 * 365), timedelta(days=825)
#: The service's own certificate for HTTP is renewed at a start within this time of its expiry.
RENEWED = timedelta(days=60)
#: The expiry of a certificate is announced this time before it.
ANNOUNCED = timedelta(days=30)


@dataclass(frozen=True)
class Identity:
    """A certificate and its key."""

    #: PEM files.
    certificate: Path
    key: Path


def opcua_identity(section: OpcuaServer, folder: Path) -> Identity:
    """Return the certificate of the OPC UA server; `own_identity` if the settings name none.

    Raises
    ------
    InputError
        The key is readable by others, or the certificate cannot be read or is not currently valid.
    """
    return _configured(section, "opcua") or own_identity(folder, section.host_names)


def http_identity(section: HttpServer, folder: Path) -> Identity:
    """Return the certificate of the HTTP server; see `opcua_identity`."""
    return _configured(section, "http") or own_certificate(folder, section)


def application_uri(identity: Identity) -> str:
    """Return the application URI in an OPC UA certificate, which clients verify."""
    names = _alternative_names(identity.certificate)
    return next(iter(names.get_values_for_type(x509.UniformResourceIdentifier)), APPLICATION)


def names_in(certificate: Path) -> list[str]:
    """Return the host names and addresses in a certificate."""
    names = _alternative_names(certificate)
    addresses = map(str, names.get_values_for_type(x509.IPAddress))
    return [*names.get_values_for_type(x509.DNSName), *addresses]


def _alternative_names(certificate: Path) -> x509.SubjectAlternativeName:
    try:
        extensions = certificate_in(certificate).extensions
        return extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return x509.SubjectAlternativeName([])


def _configured(section: Certified, where: str) -> Identity | None:
    if section.certificate_file is None or section.key_file is None:
        return None
    identity = Identity(section.certificate_file, section.key_file)
    # Readable by a group, for keys that an administrator shares between several services.
    return _checked(identity, where, "renew it", 0o007)


def own_identity(folder: Path, host_names: Sequence[str]) -> Identity:
    """Return the service's own certificate for OPC UA, which is created if there is none.

    A new one names this computer, and the names and addresses under which clients reach it.

    Raises
    ------
    InputError
        The key is readable by others, or the certificate cannot be read or has expired.
    """
    identity = Identity(folder / "certificate.pem", folder / "key.pem")
    if not identity.certificate.exists():
        names = _names("localhost", "127.0.0.1", *host_names)
        _make_for_opcua(identity, [x509.UniformResourceIdentifier(APPLICATION), *names])
    return _checked(identity, "opcua", "remove it and its key for a new one", 0o077)


def own_certificate(folder: Path, section: HttpServer, now: datetime | None = None) -> Identity:
    """Return the service's own certificate for HTTP, which is created if missing or expiring.

    It names this computer, and address and names of the section.
    """
    identity = Identity(folder / "http_certificate.pem", folder / "http_key.pem")
    now = now or datetime.now(UTC)
    own = ("localhost", socket.gethostname(), "127.0.0.1", "::1", section.address)
    names = list(_names(*own, *section.host_names))
    if not (identity.key.is_file() and _is_current(identity.certificate, names, now)):
        key = ec.generate_private_key(ec.SECP256R1())
        usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])
        builder = _builder(key, names, now, HTTP_LASTS).add_extension(usage, critical=False)
        _write(identity, key, builder.sign(key, hashes.SHA256()))
    return identity


def _is_current(path: Path, names: Sequence[x509.GeneralName], now: datetime) -> bool:
    """Return whether a certificate has these names and does not expire soon."""
    try:
        certificate, named = certificate_in(path), _alternative_names(path)
    except ValueError:
        return False
    return certificate.not_valid_after_utc - RENEWED > now and set(names) <= set(named)


def _checked(identity: Identity, where: str, remedy: str, others: int) -> Identity:
    refuse_open_to_others(identity.key, f"{where}: key", others)
    certificate = certificate_in(identity.certificate)
    if not certificate.not_valid_before_utc <= datetime.now(UTC) <= certificate.not_valid_after_utc:
        valid = f"is valid from {span_of(certificate)}"
        raise InputError(f"{identity.certificate}: {valid}; set the clock, or {remedy}")
    try:
        key = serialization.load_pem_private_key(identity.key.read_bytes(), None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{identity.key}: not a key (PEM, without a password)") from error
    if key.public_key() != certificate.public_key():
        raise InputError(
            f"{where}: {identity.certificate} and {identity.key} do not belong together; give the "
            "key of this certificate"
        )
    return identity


def expiry_warnings(given: ServiceFile, folder: Path, now: datetime) -> Iterator[str]:
    """Yield one line for each certificate that is unreadable, expires soon or is not valid yet."""
    sections = (
        ("opcua", given.opcua, "certificate.pem"),
        ("http", given.http, "http_certificate.pem"),
    )
    for name, section, own in sections:
        if section is None or section.security == "none":
            continue
        path = section.certificate_file or folder / own
        try:
            certificate = certificate_in(path)
        except InputError as error:
            yield str(error)
            continue
        if certificate.not_valid_before_utc > now:
            # Made while the clock was ahead. It is not renewed: the clock may be behind now.
            yield (
                f"{name}: {path} is valid from {span_of(certificate)}, and clients refuse it; set "
                "the clock, or remove it and its key for a new one"
            )
        end = certificate.not_valid_after_utc
        if end - ANNOUNCED < now:
            yield (
                f"{name}: {path} ends on {end:%Y-%m-%d %H:%M} UTC, in {(end - now).days} days; "
                "renew it and reload the service (SIGHUP)"
            )


def _builder(
    key: ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey,
    names: Sequence[x509.GeneralName],
    now: datetime,
    lasts: timedelta,
) -> x509.CertificateBuilder:
    """Return the common part of the service's own certificates for both interfaces."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "thermojoint")])
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + lasts)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    )


def _make_for_opcua(identity: Identity, names: Sequence[x509.GeneralName]) -> None:
    """Create a certificate as required by OPC UA, Part 6."""
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    usage = x509.KeyUsage(
        digital_signature=True,
        content_commitment=True,
        key_encipherment=True,
        data_encipherment=True,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )
    both = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    made = (
        _builder(key, names, datetime.now(UTC), OPCUA_LASTS)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(usage, critical=True)
        .add_extension(x509.ExtendedKeyUsage(both), critical=False)
        .sign(key, hashes.SHA256())
    )
    _write(identity, key, made)


def _write(
    identity: Identity,
    key: ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey,
    certificate: x509.Certificate,
) -> None:
    """Write a key, which only its owner can ever read, and its certificate."""
    content = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    identity.key.parent.mkdir(parents=True, exist_ok=True)
    # A key without a certificate is renewed; a key beside another key's certificate would not be.
    identity.certificate.unlink(missing_ok=True)
    identity.key.unlink(missing_ok=True)
    create_private(identity.key)
    identity.key.write_bytes(content)
    identity.certificate.write_bytes(certificate.public_bytes(serialization.Encoding.PEM))


def _names(*texts: str) -> Iterator[x509.GeneralName]:
    for text in dict.fromkeys(texts):
        try:
            yield x509.IPAddress(ipaddress.ip_address(text))
        except ValueError:
            yield x509.DNSName(text)
