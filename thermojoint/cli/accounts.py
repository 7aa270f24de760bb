"""Commands for the users and tokens of the service beside the control."""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments
from thermojoint.live.rights import Role

if TYPE_CHECKING:
    from thermojoint.live.settings import Service

#: Longest life of a token: a century.
_MOST_DAYS = 36_525.0


ServiceFile = Annotated[Path, typer.Argument(help="File of the service (TOML).")]
RoleOption = Annotated[
    Role | None,
    typer.Option(
        help="viewer (default) reads; operator also writes readings; engineer also changes models."
    ),
]
Machines = Annotated[
    str | None,
    typer.Option(
        help="Machines of the role: names or patterns like mill-*, with commas; default: all."
    ),
]
#: Defaults of the options above for a new user or token.
_ROLE, _MACHINES = "viewer", "*"


def users(
    service: ServiceFile,
    add: Annotated[
        str | None, typer.Option(help="Add or change this user; the password is asked for.")
    ] = None,
    remove: Annotated[str | None, typer.Option(help="Remove this user.")] = None,
    role: RoleOption = None,
    machines: Machines = None,
) -> None:
    """List, add and remove the users of a service; it may be running.

    A removed user's sessions end at once. A changed user keeps the role and the machines unless
    they are given.

    Example: [bold]thermojoint users service.toml --add anna --machines 'mill-*'[/bold]
    """
    from thermojoint import console
    from thermojoint.live.settings import read_service
    from thermojoint.live.users import add_user, read_users, remove_user

    given = read_service(service)
    path = given.users_file
    if path is None:
        raise InputError(f'{service}: no file of users; write users = "users" at its beginning')
    if add is None:
        arguments.only_for("--add", {"--role": role, "--machines": machines})
    else:
        import getpass

        former = read_users(path).get(add) if path.exists() else None
        own = role or (former.role if former else _ROLE)
        patterns = machines
        if patterns is None:
            patterns = ",".join(former.machines) if former else _MACHINES
        asked = f"password of {add}: "
        password = getpass.getpass(asked) if sys.stdin.isatty() else sys.stdin.readline()
        add_user(path, add, own, password.rstrip("\r\n"), patterns.split(","))
        audited(given, f"user {add}: {own} of {patterns}")
        console.wrote(path)
    if remove is not None:
        remove_user(path, remove)
        audited(given, f"user {remove}: removed")
        console.wrote(path)
    if add is None and remove is None:
        for name, user in (read_users(path) if path.exists() else {}).items():
            print(f"{name:24} {user.role:10} {','.join(user.machines)}")


def tokens(
    service: ServiceFile,
    add: Annotated[str | None, typer.Option(help="Make a token of this name and print it.")] = None,
    revoke: Annotated[str | None, typer.Option(help="Revoke the token of this name.")] = None,
    role: RoleOption = None,
    machines: Machines = None,
    days: Annotated[
        float | None, typer.Option(help="The token ends after these days; default: 365.", min=0.0)
    ] = None,
) -> None:
    """List, make and revoke the tokens of a service; it may be running.

    A token is printed once, when it is made; the service stores its SHA-256.

    Example: [bold]thermojoint tokens service.toml --add prometheus --days 90[/bold]
    """
    from contextlib import closing

    from thermojoint.live.access_store import open_access
    from thermojoint.live.settings import read_service
    from thermojoint.live.tokens import add_token, revoke_token, tokens_in

    if add is None:
        arguments.only_for("--add", {"--role": role, "--machines": machines, "--days": days})
    lasts = 365.0 if days is None else days
    if not 0.0 <= lasts <= _MOST_DAYS:
        raise InputError(f"--days {lasts:g}: give at most {_MOST_DAYS:g}")
    own, patterns = role or _ROLE, _MACHINES if machines is None else machines
    given = read_service(service)
    with closing(open_access(given.folder)) as store:
        if revoke is not None:
            revoke_token(store, revoke)
            audited(given, f"token {revoke}: revoked")
        if add is not None:
            now = time.time()
            span = now, now + 86400.0 * lasts
            print(add_token(store, add, own, span, patterns.split(",")))
            what = f"token {add}: {own} of {patterns} until {_day(span[1])}"
            audited(given, what)
        if add is None and revoke is None:
            for token in tokens_in(store):
                who, used = token.principal, "never" if token.used is None else _day(token.used)
                print(
                    f"{who.name:24} {who.role:10} {','.join(who.machines):24} "
                    f"until {_day(token.expires)}  used {used}"
                )


def audited(service: Service, what: str, machine: str | None = None) -> None:
    """Note an action of the user who runs a command in the audit log of a service."""
    import getpass

    from thermojoint.live.accounts import audit_of

    try:
        name = getpass.getuser()
    except (KeyError, OSError):  # a container may run under a user id without a name
        name = "unknown"
    audit_of(service).accepted(name, "command", what, machine)


def _day(seconds: float) -> str:
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M} UTC"
