"""``mocapella session``: keys of a session for other machines, and for programs with fewer rights."""

from __future__ import annotations

import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocapella.cli.app import session_app
from mocapella.cli.common import DEFAULT_PORT, OUT_HELP, say
from mocapella.errors import KeyFileError

if TYPE_CHECKING:
    from mocapella.wire.address import Address

SessionName = Annotated[
    str | None,
    typer.Option("--session", metavar="NAME", help="Name of the session; by default MOCAPELLA_SESSION, or default."),
]


@session_app.command()
def invite(
    role: Annotated[
        str,
        typer.Argument(
            metavar="ROLE", help="sensor, sensor.NAME, reader, reader+pictures, operator or operator+pictures."
        ),
    ],
    at: Annotated[
        str | None,
        typer.Option(
            "--at", metavar="HOST[:PORT]", help="Address of this session's server as the other machine sees it."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help=f"{OUT_HELP} The key, readable to you alone.")
    ] = None,
    session: SessionName = None,
) -> None:
    """Write a key for another machine or program, as a pairing code on standard output or in a file.

    Whoever has it can do what the role may: a sensor sends frames, a reader gets results, an operator also commands;
    pictures are the sensors' frames and images. `sensor.NAME` serves that sensor only, and no other key does then;
    start the server again after such an invitation. Hand a key over as you would a password.

    Example:  mocapella session invite sensor --at 192.0.2.7 --out sensor.key
    """
    from mocapella.wire.key_folder import write_private
    from mocapella.wire.role_key import write_code
    from mocapella.wire.roles import check_user, sensor_of
    from mocapella.wire.session_key import session_key, session_name

    only = sensor_of(check_user(role))
    key = session_key(session_name(session or ""))
    if only and only not in key.sensors:
        key = key.with_sensor(only)
        say(f"the session {key.session} knows the sensor {only} from the next start of its server on")
    address = _address(at)
    code = write_code(key.role_key(role, address.locator))
    what = f"a key of the session {key.session} for a {role} of {address.locator}; there: mocapella session join"
    if out is None:
        typer.echo(code)
        say(what)
        return
    write_private(out.absolute(), code + "\n")
    say(f"{out}: {what} {out.name}")


@session_app.command()
def join(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="FILE", help="A file of `mocapella session invite`; without it, the code is asked for."),
    ] = None,
) -> None:
    """Keep a key for this user, so that `--connect` to its address needs nothing more.

    The code is read from the terminal, without showing it, or from standard input: in a command line, other users of
    this machine could see it.

    Example:  mocapella session join sensor.key
    """
    from mocapella.wire.door import keep_paired, read_key_file
    from mocapella.wire.role_key import read_code

    key = read_code(_ask()) if file is None else read_key_file(file)
    kept = keep_paired(key)
    say(f"a {key.user} of the session {key.session} may connect to {key.address} now (--connect {key.address}); {kept}")


@session_app.command()
def renew(session: SessionName = None) -> None:
    """Replace a session's key: all keys that were given out are void once its server starts again.

    Example:  mocapella session renew
    """
    from mocapella.wire.session_key import renew_session_key, session_name

    key = renew_session_key(session_name(session or ""))
    say(f"the session {key.session} has a new key; start its server again, and invite the others again")


def _ask() -> str:
    if sys.stdin.isatty():
        import getpass

        return getpass.getpass("pairing code: ")
    return sys.stdin.readline(8192)


def _address(at: str | None) -> Address:
    """Return the address of the server that an invitation names."""
    from mocapella.wire.address import parse_address

    host = _own_host() if at is None else at
    has_port = host.rpartition("]")[2].count(":") == 1
    return parse_address(f"tls/{host}" if has_port else f"tls/{host}:{DEFAULT_PORT}")


def _own_host() -> str:
    """Return this machine's address on its default route; nothing is sent to find it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError as error:
            raise KeyFileError("this machine has no network address; name the server's with --at HOST") from error
        return str(probe.getsockname()[0])
