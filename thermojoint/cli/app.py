"""The table of commands.

Commands import what they work with in their own bodies: so no help page waits for a library, and
no command for those of another one.
"""

from __future__ import annotations

import warnings
from typing import Annotated

import typer

from thermojoint.cli import compensating, exporting, learning, placing, scene, serving, thermal_test
from thermojoint.cli import meshing as structures
from thermojoint.cli import modelling as models
from thermojoint.cli import simulating as simulation
from thermojoint.pictures import fonts

#: In the order of the help page.
COMMANDS = (
    simulation.simulate,
    models.calibrate,
    learning.learn,
    models.tables,
    models.assemble,
    exporting.export,
    models.estimate,
    models.validate,
    placing.place,
    compensating.compensate,
    compensating.control,
    serving.serve,
    scene.scene,
    thermal_test.iso230_3,
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


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

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
    # What overflows does not converge or is not finite, and is refused there, in one line.
    for found in ("overflow", "invalid value", "divide by zero"):
        warnings.filterwarnings("ignore", f"{found} encountered", RuntimeWarning)
    fonts.find_place()
