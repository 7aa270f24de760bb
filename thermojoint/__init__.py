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

#: Module to its public names, and a public name to its location where it has another one there;
#: the tests compare them with the imports above.
_NAMES = {
    "calibrate.chain": "Calibrated",
    "calibrate.joint_aware.calibration": "JointAwareCalibration calibrate_joint_aware",
    "calibrate.provenance": "provenance_of",
    "estimator.estimate_table": "read_estimate",
    "estimator.export.c_source": "write_c",
    "estimator.export.fmu": "write_fmu",
    "estimator.export.program": "Precision Program",
    "estimator.export.structured_text": "write_structured_text",
    "estimator.exporting": "export_program",
    "estimator.fchs.estimator": "Fchs",
    "estimator.fchs.judging": "Validated validate_model",
    "estimator.interface": "Channel Estimate Estimator Status follow",
    "estimator.joint_aware.estimator": "JointAware",
    "estimator.joint_aware.model_file": "read_observer write_observer",
    "estimator.joint_aware.observer_model": "ObserverModel",
    "estimator.learned.estimator": "Learned",
    "estimator.registry": "open_estimator resume_estimator save_state",
    "fesim.case.schema": "Case case_from_data read_case",
    "fesim.case.thermal_sections": "RampInput SampledInput StepInput TriangleInput",
    "fesim.setup.machine": "Setup set_up",
    "fesim.simulate": "Simulation simulate",
    "meshes.exchange": "read_structure write_structure",
    "meshes.structure": "Structure",
    "thermojoint.artefacts.errors": "ConvergenceError InputError ThermojointError",
    "thermojoint.artefacts.log": "Log",
    "thermojoint.artefacts.log_file": "read_log",
    "thermojoint.artefacts.response": "make_response read_response write_response",
    "thermojoint.compensation.loop.run": "Closed close_loop",
    "thermojoint.compensation.loop.schema": "Loop read_loop",
    "thermojoint.frames": "estimate learn log_from_frame reads samples validate",
    "thermojoint.models.assembly": "Assembly assemble",
    "thermojoint.models.assembly_file": "read_assembly write_assembly",
    "thermojoint.models.learned": "LearnedModel read_learned write_learned",
    "thermojoint.models.model_file": "Provenance read_model read_provenance write_model",
    "thermojoint.models.parameters": "Model",
}
_RENAMED = {
    "FmiStandard": "estimator.export.fmu:Standard",
    "OffsetSettings": "thermojoint.compensation.offsets.settings:Settings",
    "calibrate": "calibrate.chain:calibrate_responses",
    "preview_offsets": "thermojoint.compensation.offsets.preview:preview",
    "read_offset_settings": "thermojoint.compensation.offsets.settings:read_settings",
}
_HOMES = _RENAMED | {
    name: f"{module}:{name}" for module, names in _NAMES.items() for name in names.split()
}

__all__ = sorted(_HOMES)

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
