"""The command `place`: choice of sensor positions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermojoint.artefacts.settings.toml import as_key, as_text
from thermojoint.cli import arguments, file_kinds

if TYPE_CHECKING:
    from calibrate.placement.joint_aware import Placement
    from fesim.case.schema import Case
    from meshes.structure import Probe


def place(
    case: Annotated[Path, typer.Argument(help="Case file with \\[\\[candidates]].")],
    out: Annotated[Path, typer.Option(help="Probes to write (TOML), for use in a case.")],
    count: Annotated[int, typer.Option(help="Number of sensors, including those of --keep.")] = 4,
    keep: Annotated[
        list[str] | None, typer.Option(help="A probe of the case that is already installed.")
    ] = None,
    warm: Annotated[
        bool, typer.Option("--warm", help="Also for starts on a machine with an unknown past.")
    ] = False,
) -> None:
    """Place sensors for the joint-aware estimator so that its confidence band is narrow.

    Candidates are the lattice points of the case's candidates, or its probes if it has none.
    Prints the 95 % band for one sensor, two sensors, and so on; with --warm it includes what an
    unknown start leaves after 20 min. Of a machine with moving axes it is the largest of those at
    the positions that the case asks about.

    Example: [bold]thermojoint place machine.toml --count 4 --out sensors.toml[/bold]

    Example: [bold]thermojoint place machine.toml --keep s --keep b --out sensors.toml[/bold]
    """
    from fesim.case.schema import read_case
    from thermojoint.artefacts.errors import InputError
    from thermojoint.artefacts.files import write_text
    from thermojoint.artefacts.settings.section import files_of

    machine = read_case(case)
    from calibrate.joint_aware.calibration import machine_on_axes
    from calibrate.joint_aware.past import random_pasts
    from calibrate.placement.joint_aware import check_count, place_sensors
    from calibrate.placement.plant_family import (
        USUAL,
        fewer_modes,
        filter_modes,
        make_family,
        unseen_sources,
        with_start,
    )
    from fesim.axes.setup import set_up_axes
    from fesim.setup.machine import set_up
    from fesim.setup.structure import candidate_probes
    from thermojoint import console, plausibility
    from thermojoint.cli import results
    from thermojoint.reduced.machine import reduce_machine

    arguments.check_outputs({"--out": (out, file_kinds.SENSORS)}, [case, *files_of(machine)])
    kept = list(dict.fromkeys(keep or []))
    console.warn(plausibility.of_case(machine, str(case)))
    with console.working("setting up"):
        ready = set_up_axes(machine) if machine.axes else None
        setup = ready.setup if ready else set_up(machine)
    lattice = candidate_probes(machine, setup.structure)
    names = list(dict.fromkeys([*kept, *(lattice or setup.probes)]))
    unknown = [name for name in names if name not in setup.probes]
    if unknown:
        raise InputError(
            f"--keep {unknown[0]}: neither a probe nor a candidate of {case}; correct the name"
        )
    check_count(names, len(machine.sources), count, kept)
    with console.working("reducing"):
        whole = (
            machine_on_axes(machine, ready, names)
            if ready
            else reduce_machine(machine, setup, names)
        )
        reduced = fewer_modes(whole)
        seen = filter_modes(reduced)
    with console.working("drawing machines"):
        family = make_family(reduced)
        if warm:
            pasts = random_pasts(USUAL.highest, seen.power.size)
            family = with_start(family, seen, pasts)
    with console.progress_bars() as report:
        placement = place_sensors(seen, count, kept, family, report=report)
    write_text(out, written(placement, machine, setup.probes))
    results.show_placement(console.out(), placement, reduced.axes)
    console.warn(
        f"no chosen sensor is near source {source!r}, so that every change of its heat is noticed "
        f"late; place one there, e.g. by --keep {candidate}"
        for source, candidate in unseen_sources(seen, placement.chosen.names, USUAL.step).items()
    )
    console.wrote(out)


def written(placement: Placement, case: Case, probes: dict[str, Probe]) -> str:
    """Return the chosen probes that a case lacks, as sections of a case file."""
    lines = ["# Sensors placed by 'thermojoint place'."]
    there = [name for name in placement.chosen.names if name in case.probes]
    if there:
        lines.append(f"# The case has already: {', '.join(there)}.")
    for name in placement.chosen.names:
        if name in case.probes:
            continue
        probe = probes[name]
        at = ", ".join(f"{1e3 * value:.6g}" for value in probe.position)
        lines += ["", f"[probes.{as_key(name)}]", f"position_mm = [{at}]"]
        if probe.body is not None:
            lines.append(f"body = {as_text(probe.body)}")
    return "\n".join(lines) + "\n"
