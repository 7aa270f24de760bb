"""Authentication by one token, compared in constant time, and browser sessions.

A ticket is the time at which it ends and a keyed digest of that time. The key is made from the
token: another token ends every ticket, a restart of the service none.
"""

from __future__ import annotations

import hmac
import math
from dataclasses import dataclass, field
from hashlib import sha256

from thermojoint.artefacts.errors import InputError

#: Nobody guesses so many characters that were drawn at random.
SHORTEST_TOKEN = 32


@dataclass(frozen=True)
class Access:
    """Rights of a token.

    Attributes
    ----------
    digest : bytes
        SHA-256 of the token, which is itself kept nowhere.
    session : float
        How long a ticket is good for, s.
    """

    digest: bytes = field(repr=False)
    session: float

    def admits(self, token: str) -> bool:
        """Whether this is the token; takes as long for every wrong one."""
        return hmac.compare_digest(_digest(token), self.digest)

    def ticket(self, now: float) -> str:
        """Return a ticket for who has shown the token at `now` (s, Unix)."""
        end = str(math.ceil(now + self.session))
        return f"{end}.{self._seal(end)}"

    def valid(self, ticket: str, now: float) -> bool:
        """Whether a ticket is one of these and not over at `now` (s, Unix)."""
        end, _, seal = ticket.partition(".")
        if not hmac.compare_digest(self._seal(end).encode(), seal.encode("utf-8", "replace")):
            return False
        return now < int(end)

    def _seal(self, end: str) -> str:
        text = f"ticket until {end}".encode("utf-8", "replace")
        return hmac.new(self.digest, text, sha256).hexdigest()


def _digest(token: str) -> bytes:
    return sha256(token.encode("utf-8", "replace")).digest()


def access_by(token: str, session: float, where: str) -> Access:
    """Return what a token opens.

    Parameters
    ----------
    token : str
        As it is kept.
    session : float
        How long a browser stays logged in, s.
    where : str
        What the token is of, in error messages, which never show it.

    Raises
    ------
    InputError
        It is not long enough, or nothing that a header can carry.
    """
    if len(token) < SHORTEST_TOKEN or not token.isascii() or len(token.split()) != 1:
        raise InputError(
            f"{where}: a token has at least {SHORTEST_TOKEN} letters and digits; make one: "
            "openssl rand -hex 32"
        )
    return Access(_digest(token), session)
