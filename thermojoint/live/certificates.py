"""The service's own certificate: made at its first start, its key readable by the service alone."""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from thermojoint.artefacts.errors import InputError
from thermojoint.live.secret import refuse_open_to_others

#: What the service calls itself (OPC UA's application URI).
APPLICATION = "urn:thermojoint:live"
#: Own certificates hold so long, days; clients that trust one are told of the next by hand.
_DAYS = 5 * 365
_NAME = "thermojoint"


@dataclass(frozen=True)
class Identity:
    """A certificate and its key.

    Attributes
    ----------
    certificate, key : Path
        PEM.
    """

    certificate: Path
    key: Path


def own_identity(folder: Path, host_names: Sequence[str]) -> Identity:
    """Return the certificate in a folder; it is made if there is none.

    Parameters
    ----------
    folder : Path
        Where the service keeps what it must not forget.
    host_names : sequence of str
        Names and addresses under which clients reach it, for a new certificate.

    Raises
    ------
    InputError
        The key is open to others, or the certificate is not readable or has expired.
    """
    identity = Identity(folder / "certificate.pem", folder / "key.pem")
    if not identity.certificate.exists() and not identity.key.exists():
        folder.mkdir(parents=True, exist_ok=True)
        _make(identity, ["localhost", "127.0.0.1", *host_names])
    refuse_open_to_others(identity.key, "key of the service")
    try:
        certificate = x509.load_pem_x509_certificate(identity.certificate.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(
            f"{identity.certificate}: no certificate (PEM); remove it and its key for a new one"
        ) from error
    if certificate.not_valid_after_utc < datetime.now(UTC):
        raise InputError(
            f"{identity.certificate}: has expired; remove it and its key for a new one"
        )
    return identity


def _make(identity: Identity, host_names: Sequence[str]) -> None:
    """Write a key and a certificate that it signs itself."""
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, _NAME)])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(days=_DAYS))
        .add_extension(
            x509.SubjectAlternativeName(
                [
                    x509.UniformResourceIdentifier(APPLICATION),
                    *(_general_name(name) for name in dict.fromkeys(host_names)),
                ]
            ),
            critical=False,
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(
            x509.KeyUsage(
                digital_signature=True,
                content_commitment=True,
                key_encipherment=True,
                data_encipherment=True,
                key_agreement=False,
                key_cert_sign=True,
                crl_sign=False,
                encipher_only=False,
                decipher_only=False,
            ),
            critical=True,
        )
        .add_extension(
            x509.ExtendedKeyUsage(
                [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
            ),
            critical=False,
        )
        .sign(key, hashes.SHA256())
    )
    content = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    # Never readable by others, not even for a moment.
    handle = os.open(identity.key, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "wb") as file:
        file.write(content)
    identity.certificate.write_bytes(certificate.public_bytes(serialization.Encoding.PEM))


def _general_name(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def certificates_in(folder: Path) -> frozenset[bytes]:
    """Return the certificates (PEM or DER) of a folder as DER.

    Raises
    ------
    InputError
        There is no such folder, or a file in it is no certificate.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; make it, and put trusted certificates there")
    certificates = set()
    for path in sorted(folder.iterdir()):
        if path.is_file() and not path.name.startswith("."):
            certificates.add(certificate_der(path))
    return frozenset(certificates)


def certificate_der(path: Path) -> bytes:
    """Return a certificate (PEM or DER) as DER.

    Raises
    ------
    InputError
        It is none.
    """
    try:
        content = path.read_bytes()
        read = (
            x509.load_pem_x509_certificate
            if content.lstrip().startswith(b"-----")
            else x509.load_der_x509_certificate
        )
        return read(content).public_bytes(serialization.Encoding.DER)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no certificate (PEM or DER); take it away") from error
