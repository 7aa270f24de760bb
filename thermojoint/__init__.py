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

#: As in `typing`, which is not loaded here: Ctrl-C cannot be handled until this module is loaded.
TYPE_CHECKING = False
if TYPE_CHECKING:  # re-exported: each name by itself, others by an assignment
    from calibrate.chain import Calibrated as Calibrated
    from calibrate.chain import calibrate_responses as _calibrate
    from calibrate.joint_aware.calibration import JointAwareCalibration as JointAwareCalibration
    from calibrate.joint_aware.calibration import calibrate_joint_aware as calibrate_joint_aware
    from calibrate.provenance import provenance_of as provenance_of
    from estimator.estimate_table import read_estimate as read_estimate
    from estimator.export.c_source import write_c as write_c
    from estimator.export.fmu import Standard as _FmiStandard
    from estimator.export.fmu import write_fmu as write_fmu
    from estimator.export.program import Precision as Precision
    from estimator.export.program import Program as Program
    from estimator.export.structured_text import write_structured_text as write_structured_text
    from estimator.exporting import export_program as export_program
    from estimator.fchs.estimator import Fchs as Fchs
    from estimator.fchs.judging import Validated as Validated
    from estimator.fchs.judging import validate_model as validate_model
    from estimator.interface import Channel as Channel
    from estimator.interface import Estimate as Estimate
    from estimator.interface import Estimator as Estimator
    from estimator.interface import Status as Status
    from estimator.interface import follow as follow
    from estimator.joint_aware.estimator import JointAware as JointAware
    from estimator.joint_aware.model_file import read_observer as read_observer
    from estimator.joint_aware.model_file import write_observer as write_observer
    from estimator.joint_aware.observer_model import ObserverModel as ObserverModel
    from estimator.learned.estimator import Learned as Learned
    from estimator.registry import open_estimator as open_estimator
    from estimator.registry import resume_estimator as resume_estimator
    from estimator.registry import save_state as save_state
    from fesim.case.schema import Case as Case
    from fesim.case.schema import case_from_data as case_from_data
    from fesim.case.schema import read_case as read_case
    from fesim.case.thermal_sections import RampInput as RampInput
    from fesim.case.thermal_sections import SampledInput as SampledInput
    from fesim.case.thermal_sections import StepInput as StepInput
    from fesim.case.thermal_sections import TriangleInput as TriangleInput
    from fesim.setup.machine import Setup as Setup
    from fesim.setup.machine import set_up as set_up
    from fesim.simulate import Simulation as Simulation
    from fesim.simulate import simulate as simulate
    from meshes.exchange import read_structure as read_structure
    from meshes.exchange import write_structure as write_structure
    from meshes.structure import Structure as Structure
    from thermojoint.artefacts.errors import ConvergenceError as ConvergenceError
    from thermojoint.artefacts.errors import InputError as InputError
    from thermojoint.artefacts.errors import ThermojointError as ThermojointError
    from thermojoint.artefacts.log import Log as Log
    from thermojoint.artefacts.log_file import read_log as read_log
    from thermojoint.artefacts.response import make_response as make_response
    from thermojoint.artefacts.response import read_response as read_response
    from thermojoint.artefacts.response import write_response as write_response
    from thermojoint.compensation.loop.run import Closed as Closed
    from thermojoint.compensation.loop.run import close_loop as close_loop
    from thermojoint.compensation.loop.schema import Loop as Loop
    from thermojoint.compensation.loop.schema import read_loop as read_loop
    from thermojoint.compensation.offsets.preview import preview as _preview_offsets
    from thermojoint.compensation.offsets.settings import Settings as _OffsetSettings
    from thermojoint.compensation.offsets.settings import read_settings as _read_offset_settings
    from thermojoint.frames import estimate as estimate
    from thermojoint.frames import learn as learn
    from thermojoint.frames import log_from_frame as log_from_frame
    from thermojoint.frames import reads as reads
    from thermojoint.frames import samples as samples
    from thermojoint.frames import validate as validate
    from thermojoint.models.assembly import Assembly as Assembly
    from thermojoint.models.assembly import assemble as assemble
    from thermojoint.models.assembly_file import read_assembly as read_assembly
    from thermojoint.models.assembly_file import write_assembly as write_assembly
    from thermojoint.models.learned import LearnedModel as LearnedModel
    from thermojoint.models.learned import read_learned as read_learned
    from thermojoint.models.learned import write_learned as write_learned
    from thermojoint.models.model_file import Provenance as Provenance
    from thermojoint.models.model_file import read_model as read_model
    from thermojoint.models.model_file import read_provenance as read_provenance
    from thermojoint.models.model_file import write_model as write_model
    from thermojoint.models.parameters import Model as Model

    calibrate = _calibrate
    FmiStandard = _FmiStandard
    preview_offsets = _preview_offsets
    OffsetSettings = _OffsetSettings
    read_offset_settings = _read_offset_settings
    __version__: str

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

__all__ = [*_HOMES]

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
    """Return the public names, for completion."""
    return [*__all__, "__version__"]
