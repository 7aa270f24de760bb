"""Numbers of a case that may be varied one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import Any

from fesim.case.schema import Case, MillingMachineSection
from meshes.milling_machine import MillingMachineDimensions
from thermojoint.artefacts.units import MILLI

#: Sections whose numbers do not describe the machine.
_LEFT_OUT = {"title", "march", "output", "candidates", "displacement", "volume"}
#: Numbers of a mesh, not of the machine.
_MESHED = {"structure.element_size_mm", "structure.joint_element_size_mm"}
#: Numbers of an axis without a magnitude, for its mesh and stations, or for its outputs.
_READ = {
    "direction",
    "station_mm",
    "mesh_position_mm",
    "asked_mm",
    "reference_mm",
    "rotation_within_mm",
}
#: Points, and dimensions of a machine beside them: a percentage of a coordinate would depend on the
#: origin.
_POINT = "_mm."
#: Lengths, of which a zero is no place but a part that is not there.
_DIMENSIONS = "structure.dimensions_mm."
#: Coordinates along an axis, of its drives.
_ALONG = {"zero_mm", "fixed_bearing_mm", "far_end_mm", "nut_mm", "fixed_mm", "head_mm"}


@dataclass(frozen=True)
class Parameter:
    """A number of a case."""

    #: Its path in the case file, with dots.
    path: str
    #: Value in the unit of the path.
    value: float
    #: Change to which effects refer: a hundredth of the value, with its sign, or 1 mm for a
    #: coordinate.
    unit_change: float

    @property
    def change(self) -> str:
        """The change in words."""
        return "1 mm" if _is_coordinate(self.path) else "1 %"


def _is_coordinate(path: str) -> bool:
    return _POINT in path or path.rpartition(".")[2] in _ALONG


def numbers_of(case: Case) -> dict[str, float]:
    """Return the numbers of a case by path, zeros included.

    Integers, and the numbers of march, mesh and outputs are left out.
    """
    data = case.model_dump(mode="json", exclude=_LEFT_OUT)
    data["axes"] = {
        name: {key: value for key, value in axis.items() if key not in _READ}
        for name, axis in data["axes"].items()
    }
    if isinstance(case.structure, MillingMachineSection):
        usual = asdict(MillingMachineDimensions())
        # Values derived from others are None.
        dimensions = {name: v / MILLI for name, v in usual.items() if v is not None}
        data["structure"]["dimensions_mm"] = dimensions | case.structure.dimensions_mm
    return {path: value for path, value in _numbers(data, "") if path not in _MESHED}


def parameters_of(case: Case, patterns: tuple[str, ...] = ("*",)) -> list[Parameter]:
    """Return the numbers of a case whose paths match one of the patterns (``*``, ``?``).

    Of those of `numbers_of`, zeros without a magnitude to refer to are left out.
    """
    found = []
    for path, value in numbers_of(case).items():
        matched = any(fnmatchcase(path, pattern) for pattern in patterns)
        placed = _is_coordinate(path)
        if matched and (value or (placed and not path.startswith(_DIMENSIONS))):
            found.append(Parameter(path, value, 1.0 if placed else 0.01 * value))
    return found


def _numbers(data: Any, above: str) -> Iterator[tuple[str, float]]:  # noqa: ANN401 - any JSON value
    parts = dict(enumerate(data)) if isinstance(data, list) else data
    if isinstance(parts, dict):
        for key, part in parts.items():
            yield from _numbers(part, f"{above}.{key}" if above else str(key))
    elif isinstance(data, float):
        yield above, data
