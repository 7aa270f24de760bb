"""The command line: runs the commands and turns errors into one line."""

from __future__ import annotations

import signal
from importlib.metadata import version
from types import FrameType
from typing import Annotated

import numpy as np
import typer

from artefacts.errors import ThermojointError
from thermojoint import console
from thermojoint.commands import models, simulation, structures

#: Exit code of everything the user can mend.
BAD_INPUT = 2

#: In the order of the help page.
COMMANDS = (
    simulation.simulate,
    models.calibrate,
    models.tables,
    models.assemble,
    models.estimate,
    models.validate,
    models.reproduce,
    structures.view,
    simulation.verify,
    structures.mesh,
    structures.inspect,
    simulation.batch,
)

app = typer.Typer(
    help="Nonlinear thermoelastic machine tools: simulate the joints, calibrate the generalised "
    "models, estimate the displacement in real time from temperatures.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)

for command in COMMANDS:
    app.command()(command)


def main() -> None:
    """Run the command line; errors a user can mend are one line on standard error, exit code 2."""
    signal.signal(signal.SIGTERM, _stop)
    # What overflows does not converge or is not finite, and is refused there, in one line.
    np.seterr(over="ignore", invalid="ignore", divide="ignore")
    try:
        app()
    except ThermojointError as error:
        _fail(str(error))
    except MemoryError as error:
        _fail(f"not enough memory ({error}); take larger elements or a shorter run")
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror or error}; choose another place")


def _stop(number: int, frame: FrameType | None) -> None:
    """End as after Ctrl-C, so that no half-written file stays behind."""
    raise SystemExit(128 + number)


def _fail(message: str) -> None:
    console.say("thermojoint: " + " ".join(message.split()))
    raise SystemExit(BAD_INPUT)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"thermojoint {version('thermojoint')}")
        raise typer.Exit


@app.callback()
def _every_command(
    show_version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version and end.", callback=_show_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Options before the command."""


if __name__ == "__main__":
    main()
