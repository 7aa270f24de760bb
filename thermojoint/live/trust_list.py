"""Trust list of the OPC UA server: accepted and rejected client certificates.

The folder holds certificates of clients and of authorities (CA) that issue them, and revocation
lists (CRL) of these authorities. It is read at every log-in, so a change needs no restart.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TypeVar

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes

from thermojoint.artefacts.errors import InputError

Content = TypeVar("Content")
#: Number of rejected certificates that are kept; anybody can send some.
_MOST_REJECTED = 100


@dataclass(frozen=True)
class TrustList:
    """Folders of certificates."""

    #: None: any client with a currently valid certificate, as the password decides.
    trusted: Path | None
    #: Folder for unknown certificates, from which an administrator moves them to `trusted`.
    rejected: Path

    def refusal(self, certificate: bytes | None, now: datetime) -> str:
        """Return why a client's certificate (DER) is refused; empty if it is accepted."""
        if not certificate:
            return "" if self.trusted is None else "no certificate"
        try:
            given = x509.load_der_x509_certificate(certificate)
        except ValueError:
            return "not a certificate"
        if not given.not_valid_before_utc <= now <= given.not_valid_after_utc:
            return f"the certificate is valid from {span_of(given)}"
        if self.trusted is None:
            return ""
        try:
            known, lists = contents_of(self.trusted)
        except InputError as error:
            return str(error)
        if given in known:
            return ""
        authorities = [one for one in known if _issued(given, one, now)]
        if not authorities:
            self._keep(given, certificate)
            return "the certificate is not trusted"
        if any(_revokes(one, given, authorities) for one in lists):
            return "the certificate has been revoked"
        return ""

    def _keep(self, given: x509.Certificate, certificate: bytes) -> None:
        """Put a certificate into the folder of the rejected ones."""
        with suppress(OSError):
            self.rejected.mkdir(parents=True, exist_ok=True)
            subject = re.sub(r"[^A-Za-z0-9._-]+", "_", given.subject.rfc4514_string())[:60]
            path = self.rejected / f"{subject}-{given.fingerprint(hashes.SHA256()).hex()[:16]}.der"
            if len(list(self.rejected.iterdir())) < _MOST_REJECTED:
                path.write_bytes(certificate)


def contents_of(
    folder: Path,
) -> tuple[list[x509.Certificate], list[x509.CertificateRevocationList]]:
    """Return the certificates and revocation lists (PEM or DER; lists end in .crl) of a folder.

    Raises
    ------
    InputError
        There is no such folder, or a file in it is neither a certificate nor a list.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; make it, and put trusted certificates there")
    paths = [one for one in sorted(folder.iterdir()) if one.is_file() and one.name[0] != "."]
    lists = [_revocations(path) for path in paths if path.suffix == ".crl"]
    return [certificate_in(path) for path in paths if path.suffix != ".crl"], lists


def span_of(certificate: x509.Certificate) -> str:
    """Return the days on which a certificate becomes valid and expires."""
    return (
        f"{certificate.not_valid_before_utc:%Y-%m-%d} to {certificate.not_valid_after_utc:%Y-%m-%d}"
    )


def certificate_in(path: Path) -> x509.Certificate:
    """Return a certificate (PEM or DER).

    Raises
    ------
    InputError
        The file is not a certificate.
    """
    return _loaded(
        path, "certificate", x509.load_pem_x509_certificate, x509.load_der_x509_certificate
    )


def _revocations(path: Path) -> x509.CertificateRevocationList:
    return _loaded(path, "revocation list", x509.load_pem_x509_crl, x509.load_der_x509_crl)


def _loaded(
    path: Path, what: str, pem: Callable[[bytes], Content], der: Callable[[bytes], Content]
) -> Content:
    try:
        content = path.read_bytes()
        return (pem if content.lstrip().startswith(b"-----") else der)(content)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a {what} (PEM or DER); remove it") from error


def _issued(given: x509.Certificate, authority: x509.Certificate, now: datetime) -> bool:
    """Return whether a certificate was issued by an authority that is currently valid."""
    try:
        rights = authority.extensions.get_extension_for_class(x509.BasicConstraints).value
        given.verify_directly_issued_by(authority)
    except (x509.ExtensionNotFound, ValueError, TypeError, InvalidSignature):
        return False
    return rights.ca and authority.not_valid_before_utc <= now <= authority.not_valid_after_utc


def _revokes(
    revocations: x509.CertificateRevocationList,
    given: x509.Certificate,
    authorities: Sequence[x509.Certificate],
) -> bool:
    """Return whether a list signed by an authority revokes a certificate."""
    listed = revocations.get_revoked_certificate_by_serial_number(given.serial_number)
    return listed is not None and any(
        revocations.is_signature_valid(one.public_key())  # type: ignore[arg-type]
        for one in authorities
    )
