"""Simulate nonlinear thermal joints, calibrate the generalised models, estimate displacement.

Every public name of the program is an attribute of this package, and is listed in `__all__`. Its
object is loaded when it is first used: ``import thermojoint`` alone loads no library.

Examples
--------
>>> import thermojoint as tj
>>> response = tj.simulate(tj.read_case("machine.toml")).response  # doctest: +SKIP
"""

from __future__ import annotations

from thermojoint.own_packages import check_not_hidden

check_not_hidden()

#: As in `typing`, which is not loaded here: the command line cannot handle Ctrl-C before this is.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from calibrate.chain import Calibrated
    from calibrate.chain import calibrate_responses as calibrate
    from calibrate.joint_aware.calibration import JointAwareCalibration, calibrate_joint_aware
    from calibrate.provenance import provenance_of
    from estimator.estimate_table import read_estimate
    from estimator.export.c_source import write_c
    from estimator.export.fmu import Standard as FmiStandard
    from estimator.export.fmu import write_fmu
    from estimator.export.program import Precision, Program
    from estimator.export.structured_text import write_structured_text
    from estimator.exporting import export_program
    from estimator.fchs.estimator import Fchs
    from estimator.fchs.judging import Validated, validate_model
    from estimator.interface import Channel, Estimate, Estimator, Status, follow
    from estimator.joint_aware.estimator import JointAware
    from estimator.joint_aware.model_file import read_observer, write_observer
    from estimator.joint_aware.observer_model import ObserverModel
    from estimator.learned.estimator import Learned
    from estimator.registry import open_estimator, resume_estimator, save_state
    from fesim.case.schema import Case, case_from_data, read_case
    from fesim.case.thermal_sections import RampInput, SampledInput, StepInput, TriangleInput
    from fesim.setup.machine import Setup, set_up
    from fesim.simulate import Simulation, simulate
    from meshes.exchange import read_structure, write_structure
    from meshes.structure import Structure
    from thermojoint.artefacts.errors import ConvergenceError, InputError, ThermojointError
    from thermojoint.artefacts.log import Log
    from thermojoint.artefacts.log_file import read_log
    from thermojoint.artefacts.response import make_response, read_response, write_response
    from thermojoint.compensation.loop.run import Closed, close_loop
    from thermojoint.compensation.loop.schema import Loop, read_loop
    from thermojoint.compensation.offsets.preview import preview as preview_offsets
    from thermojoint.compensation.offsets.settings import Settings as OffsetSettings
    from thermojoint.compensation.offsets.settings import read_settings as read_offset_settings
    from thermojoint.frames import estimate, learn, log_from_frame, reads, samples, validate
    from thermojoint.models.assembly import Assembly, assemble
    from thermojoint.models.assembly_file import read_assembly, write_assembly
    from thermojoint.models.learned import LearnedModel, read_learned, write_learned
    from thermojoint.models.model_file import Provenance, read_model, read_provenance, write_model
    from thermojoint.models.parameters import Model

    __version__: str

__all__ = [
    "Assembly",
    "Calibrated",
    "Case",
    "Channel",
    "Closed",
    "ConvergenceError",
    "Estimate",
    "Estimator",
    "Fchs",
    "FmiStandard",
    "InputError",
    "JointAware",
    "JointAwareCalibration",
    "Learned",
    "LearnedModel",
    "Log",
    "Loop",
    "Model",
    "ObserverModel",
    "OffsetSettings",
    "Precision",
    "Program",
    "Provenance",
    "RampInput",
    "SampledInput",
    "Setup",
    "Simulation",
    "Status",
    "StepInput",
    "Structure",
    "ThermojointError",
    "TriangleInput",
    "Validated",
    "assemble",
    "calibrate",
    "calibrate_joint_aware",
    "case_from_data",
    "close_loop",
    "estimate",
    "export_program",
    "follow",
    "learn",
    "log_from_frame",
    "make_response",
    "open_estimator",
    "preview_offsets",
    "provenance_of",
    "read_assembly",
    "read_case",
    "read_estimate",
    "read_learned",
    "read_log",
    "read_loop",
    "read_model",
    "read_observer",
    "read_offset_settings",
    "read_provenance",
    "read_response",
    "read_structure",
    "reads",
    "resume_estimator",
    "samples",
    "save_state",
    "set_up",
    "simulate",
    "validate",
    "validate_model",
    "write_assembly",
    "write_c",
    "write_fmu",
    "write_learned",
    "write_model",
    "write_observer",
    "write_response",
    "write_structure",
    "write_structured_text",
]

#: Public name to its location; the tests compare them with the imports above.
_HOMES = {
    "Assembly": "thermojoint.models.assembly:Assembly",
    "Calibrated": "calibrate.chain:Calibrated",
    "Case": "fesim.case.schema:Case",
    "Channel": "estimator.interface:Channel",
    "Closed": "thermojoint.compensation.loop.run:Closed",
    "ConvergenceError": "thermojoint.artefacts.errors:ConvergenceError",
    "Estimate": "estimator.interface:Estimate",
    "Estimator": "estimator.interface:Estimator",
    "Fchs": "estimator.fchs.estimator:Fchs",
    "FmiStandard": "estimator.export.fmu:Standard",
    "InputError": "thermojoint.artefacts.errors:InputError",
    "JointAware": "estimator.joint_aware.estimator:JointAware",
    "JointAwareCalibration": "calibrate.joint_aware.calibration:JointAwareCalibration",
    "Learned": "estimator.learned.estimator:Learned",
    "LearnedModel": "thermojoint.models.learned:LearnedModel",
    "Log": "thermojoint.artefacts.log:Log",
    "Loop": "thermojoint.compensation.loop.schema:Loop",
    "Model": "thermojoint.models.parameters:Model",
    "ObserverModel": "estimator.joint_aware.observer_model:ObserverModel",
    "OffsetSettings": "thermojoint.compensation.offsets.settings:Settings",
    "Precision": "estimator.export.program:Precision",
    "Program": "estimator.export.program:Program",
    "Provenance": "thermojoint.models.model_file:Provenance",
    "RampInput": "fesim.case.thermal_sections:RampInput",
    "SampledInput": "fesim.case.thermal_sections:SampledInput",
    "Setup": "fesim.setup.machine:Setup",
    "Simulation": "fesim.simulate:Simulation",
    "Status": "estimator.interface:Status",
    "StepInput": "fesim.case.thermal_sections:StepInput",
    "Structure": "meshes.structure:Structure",
    "ThermojointError": "thermojoint.artefacts.errors:ThermojointError",
    "TriangleInput": "fesim.case.thermal_sections:TriangleInput",
    "Validated": "estimator.fchs.judging:Validated",
    "assemble": "thermojoint.models.assembly:assemble",
    "calibrate": "calibrate.chain:calibrate_responses",
    "calibrate_joint_aware": "calibrate.joint_aware.calibration:calibrate_joint_aware",
    "case_from_data": "fesim.case.schema:case_from_data",
    "close_loop": "thermojoint.compensation.loop.run:close_loop",
    "estimate": "thermojoint.frames:estimate",
    "export_program": "estimator.exporting:export_program",
    "follow": "estimator.interface:follow",
    "learn": "thermojoint.frames:learn",
    "log_from_frame": "thermojoint.frames:log_from_frame",
    "make_response": "thermojoint.artefacts.response:make_response",
    "open_estimator": "estimator.registry:open_estimator",
    "preview_offsets": "thermojoint.compensation.offsets.preview:preview",
    "provenance_of": "calibrate.provenance:provenance_of",
    "read_assembly": "thermojoint.models.assembly_file:read_assembly",
    "read_case": "fesim.case.schema:read_case",
    "read_estimate": "estimator.estimate_table:read_estimate",
    "read_learned": "thermojoint.models.learned:read_learned",
    "read_log": "thermojoint.artefacts.log_file:read_log",
    "read_loop": "thermojoint.compensation.loop.schema:read_loop",
    "read_model": "thermojoint.models.model_file:read_model",
    "read_observer": "estimator.joint_aware.model_file:read_observer",
    "read_offset_settings": "thermojoint.compensation.offsets.settings:read_settings",
    "read_provenance": "thermojoint.models.model_file:read_provenance",
    "read_response": "thermojoint.artefacts.response:read_response",
    "read_structure": "meshes.exchange:read_structure",
    "reads": "thermojoint.frames:reads",
    "resume_estimator": "estimator.registry:resume_estimator",
    "samples": "thermojoint.frames:samples",
    "save_state": "estimator.registry:save_state",
    "set_up": "fesim.setup.machine:set_up",
    "simulate": "fesim.simulate:simulate",
    "validate": "thermojoint.frames:validate",
    "validate_model": "estimator.fchs.judging:validate_model",
    "write_assembly": "thermojoint.models.assembly_file:write_assembly",
    "write_c": "estimator.export.c_source:write_c",
    "write_fmu": "estimator.export.fmu:write_fmu",
    "write_learned": "thermojoint.models.learned:write_learned",
    "write_model": "thermojoint.models.model_file:write_model",
    "write_observer": "estimator.joint_aware.model_file:write_observer",
    "write_response": "thermojoint.artefacts.response:write_response",
    "write_structure": "meshes.exchange:write_structure",
    "write_structured_text": "estimator.export.structured_text:write_structured_text",
}

if not TYPE_CHECKING:  # a type checker sees the imports above, and refuses any other name

    def __getattr__(name: str) -> object:
        """Load a public name when it is first used (PEP 562)."""
        if name == "__version__":
            from importlib.metadata import version

            return version("thermojoint")
        if name not in _HOMES:
            raise AttributeError(f"module 'thermojoint' has no attribute {name!r}")
        from pkgutil import resolve_name

        return globals().setdefault(name, resolve_name(_HOMES[name]))


def __dir__() -> list[str]:
    """Return what completion offers: the public names."""
    return [*__all__, "__version__"]
