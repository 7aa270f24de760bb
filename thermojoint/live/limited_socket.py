"""Listening socket with limits, for a server that other computers can reach."""

from __future__ import annotations

import socket
from typing import Any

from thermojoint.artefacts.errors import InputError
from thermojoint.live.descriptors import leaves_reserve
from thermojoint.live.ip_address import family_of


class LimitedSocket(socket.socket):
    """Listening socket that closes connections beyond a limit at once, before TLS.

    The limits are `most` connections in total, and `most_of_one` per address.
    """

    def __init__(self, listening: socket.socket, most: int, most_of_one: int) -> None:
        super().__init__(
            listening.family, listening.type, listening.proto, fileno=listening.detach()
        )
        self.most, self.most_of_one = most, most_of_one
        self.connections: list[tuple[str, socket.socket]] = []

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection.

        Raises
        ------
        ConnectionAbortedError
            There are too many, in total or from its address; asyncio goes on with the next.
        """
        connection, address = super().accept()
        host = str(address[0])
        self.connections = [one for one in self.connections if one[1].fileno() >= 0]
        same = sum(one[0] == host for one in self.connections)
        full = len(self.connections) >= self.most or same >= self.most_of_one
        if full or not leaves_reserve(connection.fileno()):
            connection.close()
            raise ConnectionAbortedError
        self.connections.append((host, connection))
        return connection, address


def listening(where: str, address: str, port: int, most: int, most_of_one: int) -> LimitedSocket:
    """Return a socket that listens at an address, with the limits of `LimitedSocket`.

    Raises
    ------
    InputError
        The address cannot be bound; `where` names the section.
    """
    try:
        bound = socket.create_server((address, port), family=family_of(address))
    except OSError as error:
        raise InputError(
            f"{where}: cannot listen at {address}:{port} ({error.strerror}); give an address of "
            "this computer and a port that is free"
        ) from error
    return LimitedSocket(bound, most, most_of_one)
