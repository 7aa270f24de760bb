"""Connection to an external OPC UA server, with certificates, user and password."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from pathlib import Path

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

from thermojoint.artefacts.errors import InputError
from thermojoint.live.certificates import APPLICATION, Identity, own_identity
from thermojoint.live.secret import read_secret
from thermojoint.live.settings import OpcuaAddress
from thermojoint.live.trust_list import certificate_in

#: Timeout of a response, s.
TIMEOUT_S = 10.0
#: Errors that end a connection.
LOST = (OSError, TimeoutError, asyncio.TimeoutError, ua.UaError, ConnectionError)


@dataclass(frozen=True)
class Endpoint:
    """Connection data of a server; secrets are never displayed."""

    url: str
    #: Own certificate, and the server's; None without security.
    own: Identity | None
    server: Path | None
    user: str | None
    password: str | None

    def __repr__(self) -> str:
        return f"Endpoint({self.url})"


def endpoint_of(given: OpcuaAddress, folder: Path, where: str) -> Endpoint:
    """Return the connection data of a server; `folder` has the service's own certificate.

    Raises
    ------
    InputError
        The server's certificate or a secret cannot be used.
    """
    own = server = password = None
    if given.security == "sign-and-encrypt":
        if given.server_certificate is None:
            raise InputError(
                f"{where}.server_certificate: missing; give the certificate of the server to trust "
                "(PEM or DER)"
            )
        server = given.server_certificate
        certificate_in(server)
        own = own_identity(folder, ())
    if given.password is not None:
        password = read_secret(given.password, f"{where}.password")
    return Endpoint(given.url, own, server, given.user, password)


async def client_of(endpoint: Endpoint) -> Client:
    """Return a client that is not connected yet."""
    client = Client(endpoint.url, timeout=TIMEOUT_S)
    client.application_uri = APPLICATION
    client.name = client.description = "thermojoint"
    if endpoint.own is not None and endpoint.server is not None:
        await client.set_security(
            SecurityPolicyBasic256Sha256,
            certificate=endpoint.own.certificate,
            private_key=endpoint.own.key,
            server_certificate=str(endpoint.server),
            mode=ua.MessageSecurityMode.SignAndEncrypt,
        )
    if endpoint.user is not None:
        client.set_user(endpoint.user)
        client.set_password(endpoint.password or "")
    return client
