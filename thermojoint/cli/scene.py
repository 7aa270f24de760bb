"""The command `scene`: the machine's surface for the 3-D picture of the dashboard."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thermojoint.cli import arguments, file_kinds


def scene(
    case: Annotated[Path, typer.Argument(help="Case that the model was calibrated with (TOML).")],
    model: Annotated[Path, typer.Argument(help="Joint-aware model.")],
    out: Annotated[Path, typer.Option(help="Surface of the machine to write (.h5).")],
) -> None:
    """Write the surface of a machine, for the 3-D picture in the service's dashboard.

    A joint-aware model has no mesh; this file contains the outer faces and their temperatures in
    terms of the model's state. The service file names it beside the model: scene =
    "machine_scene.h5".

    Example: [bold]thermojoint scene machine.toml joint_aware.h5 --out machine_scene.h5[/bold]
    """
    arguments.check_outputs({"--out": (out, file_kinds.SURFACE)}, [case, model])
    import numpy as np

    from estimator.joint_aware.model_file import read_observer
    from fesim.case.schema import read_case
    from fesim.setup.machine import set_up
    from thermojoint import console
    from thermojoint.artefacts.errors import InputError
    from thermojoint.live.surface import surface_of, write_surface
    from thermojoint.pictures.scenes import up_direction

    given = read_case(case)
    if given.axes:
        raise InputError(
            f"{case}: a scene shows a machine that stands, and its {', '.join(given.axes)} may "
            "move; leave out scene in the service file"
        )
    observer = read_observer(model)
    march = given.march.model_copy(update={"thermal": "reduced"})
    given = given.model_copy(update={"march": march})
    with console.working("setting up"):
        setup = set_up(given)
        held = (*given.supports.fixed, *given.supports.springs)
        up = np.array(up_direction(setup.structure, held))
        write_surface(surface_of(given, setup, observer, up), out)
    console.wrote(out)
