"""The commands and their groups.

Commands import libraries in their own bodies, so that help pages and other commands start fast.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Annotated

import typer

from thermojoint.cli import (
    accounts,
    compensating,
    exporting,
    learning,
    looking,
    optimising,
    placing,
    scene,
    serving,
    targets,
    thermal_test,
)
from thermojoint.cli import meshing as structures
from thermojoint.cli import modelling as models
from thermojoint.cli import sensitivity as sensitivities
from thermojoint.cli import simulating as simulation
from thermojoint.cli.command import help_text, with_verbosity
from thermojoint.pictures import fonts

#: Panels of the help page and their commands, in order.
COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    "Simulate": (
        structures.mesh,
        structures.inspect,
        simulation.simulate,
        simulation.batch,
        sensitivities.sensitivity,
        optimising.optimise,
    ),
    "Calibrate and learn": (models.calibrate, learning.learn, placing.place, models.assemble),
    "Estimate": (models.estimate, models.validate),
    "Beside the control": (
        exporting.export,
        compensating.compensate,
        compensating.control,
        serving.setup,
        serving.serve,
        serving.rollback,
        serving.backup,
        serving.restore,
        accounts.users,
        accounts.tokens,
        targets.linuxcnc,
        targets.target,
        scene.scene,
    ),
    "Look and check": (
        looking.look,
        structures.view,
        models.tables,
        thermal_test.iso230_3,
        simulation.verify,
        models.reproduce,
    ),
}

app = typer.Typer(
    help="Nonlinear thermoelastic machine tools: simulate the joints, calibrate the generalised "
    "models, estimate the displacement in real time from temperatures.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)

for panel, commands in COMMANDS.items():
    for command in commands:
        listed = app.command(help=help_text(command.__doc__), rich_help_panel=panel)
        listed(with_verbosity(command))


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
    # Overflows lead to errors about convergence or finite values, which are reported in one line.
    for kind in ("overflow", "invalid value", "divide by zero"):
        warnings.filterwarnings("ignore", f"{kind} encountered", RuntimeWarning)
    fonts.find_place()
