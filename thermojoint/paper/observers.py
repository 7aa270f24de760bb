"""Observers based on the machine's physics, calibrated for the machine of a case.

Their model has a coarser mesh than the plant; it is calibrated from the plant's responses like
every other estimator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING

from calibrate.joint_aware.calibration import USUAL, Effort, calibrate_machine
from calibrate.joint_aware.linear_joint import calibrate_linear_joint
from calibrate.joint_aware.report import report
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import read_observer, write_observer
from fesim.case.schema import (
    Case,
    MillingMachineSection,
    ProbeSection,
    secant_sections,
    solid_sections,
)
from fesim.case.thermal_sections import StepInput
from fesim.one_thread import one_thread
from fesim.setup.machine import set_up
from meshes.structure import Probe
from thermojoint.artefacts.errors import ThermojointError
from thermojoint.artefacts.json_file import write_json
from thermojoint.reduced.machine import reduce_machine
from thermojoint.reduced.parameters import ABSOLUTE, shown

if TYPE_CHECKING:
    import xarray as xr

#: Element size of the model relative to the plant.
COARSER = 1.25
#: Calibration function of each kind of observer.
KINDS = {"kalman-linear": calibrate_linear_joint, "joint-aware": calibrate_machine}


def observer_case(case: Case, sensors: Mapping[str, Probe]) -> Case:
    """Return the machine of a case with the sensors and the mesh of its observers.

    The milling machine is remeshed with elements `COARSER` times as large; a mesh from a file is
    used unchanged.
    """
    structure = case.structure
    if isinstance(structure, MillingMachineSection):
        near = structure.joint_element_size_mm
        sizes = {
            "element_size_mm": COARSER * structure.element_size_mm,
            "joint_element_size_mm": None if near is None else COARSER * near,
        }
        structure = structure.model_copy(update=sizes)
    added = {name: _section(probe) for name, probe in sensors.items()}
    return case.model_copy(
        update={
            "structure": structure,
            "probes": case.probes | added,
            "candidates": [],
            "heat_input": StepInput(kind="step", level=1.0),
            "march": case.march.model_copy(update={"thermal": "reduced"}),
        }
    )


def _section(probe: Probe) -> ProbeSection:
    """Return a probe as a section of a case, without the rounding of mm to m and back."""
    x, y, z = (round(1e3 * value, 6) for value in probe.position)
    return ProbeSection(position_mm=(x, y, z), body=probe.body)


def observers_beside(
    crew: Executor,
    case: Case,
    sensors: Mapping[str, Probe],
    responses: Mapping[str, xr.Dataset],
    folder: Path,
    effort: Effort = USUAL,
) -> Callable[[], tuple[list[JointAware], dict[str, str]]]:
    """Calibrate the observers of a machine in the processes of `crew` while the caller continues.

    Returns a function that waits for the observers and returns them, with the reasons for missing
    ones: the case has a feature that they do not support, or a calibration failed. The models
    ``joint_aware.h5`` and ``kalman_linear.h5`` and the reports on their parameters (``.json``) are
    written to `folder`.
    """
    if case.held_temperatures or secant_sections(case) or solid_sections(case):
        reason = "held temperatures and properties that vary have no reduced-order model"
        return lambda: ([], dict.fromkeys(KINDS, reason))
    known = observer_case(case, sensors)
    paths = {
        kind: crew.submit(_calibrated, kind, known, tuple(sensors), responses, folder, effort)
        for kind in KINDS
    }

    def wait() -> tuple[list[JointAware], dict[str, str]]:
        had: list[JointAware] = []
        left_out: dict[str, str] = {}
        for kind, path in paths.items():
            try:
                had.append(JointAware(read_observer(path.result())))
            except ThermojointError as error:
                left_out[kind] = str(error)
        return had, left_out

    return wait


def _calibrated(
    kind: str,
    known: Case,
    sensors: tuple[str, ...],
    responses: Mapping[str, xr.Dataset],
    folder: Path,
    effort: Effort,
) -> Path:
    """Calibrate one observer, write it and its report, and return its file."""
    machine = reduce_machine(known, set_up(known), sensors)
    with one_thread():
        calibrated = KINDS[kind](machine, responses, effort=effort)
    path = folder / f"{kind.replace('-', '_')}.h5"
    write_observer(calibrated.model, path)
    write_json(path.with_suffix(".json"), report(calibrated.fit))
    return path


def fitted_text(observer: JointAware) -> str:
    """Return the calibrated parameters of the machine, one per line."""
    lines = []
    for name, (factor, spread) in observer.model.factors.items():
        value, uncertain = shown(name, factor, spread)
        of = "" if name.endswith(ABSOLUTE) else " of the case's value"
        lines.append(f"{name:<20} {value}{of}, uncertain by {uncertain}")
    return "\n".join(lines)
