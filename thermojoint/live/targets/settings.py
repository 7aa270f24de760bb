"""File of a target (TOML): kind of control, its connection, and the axes that move."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.settings import toml
from thermojoint.artefacts.settings.read import settings_from
from thermojoint.artefacts.settings.section import Count, Finite, Section
from thermojoint.artefacts.units import MICRO, MILLI
from thermojoint.compensation.offsets.output import OutputSettings
from thermojoint.live.settings import OpcuaAddress, check_protected
from thermojoint.live.targets.beckhoff import BECKHOFF
from thermojoint.live.targets.control import Control, Quantity, in_units, steps_in
from thermojoint.live.targets.sinumerik import SINUMERIK

#: Tolerance for a position given in mm, m.
_ROUNDING = 1e-9
CONTROLS: Mapping[str, Control] = {"sinumerik": SINUMERIK, "beckhoff": BECKHOFF}


class SlopeSection(Section):
    """``[slopes.NAME]``: the control takes a slope for this axis, with this P0 and stroke."""

    reference_mm: Finite
    stroke_mm: Annotated[tuple[Finite, Finite], Field(strict=False)]

    @property
    def reference(self) -> float:
        """P0, m."""
        return MILLI * self.reference_mm

    @property
    def lever(self) -> float:
        """Largest distance from P0 on the stroke, m."""
        return MILLI * max(abs(end - self.reference_mm) for end in self.stroke_mm)


class Write(NamedTuple):
    """A value that is written into a control."""

    quantity: Quantity
    #: Axis of the offsets.
    axis: str
    #: Largest change by one write, m or m/m.
    most: float


class TargetFile(OpcuaAddress):
    """The whole file.

    ``axes`` maps every axis of the offsets to the number of the control's axis, ``nodes`` maps
    names of quantities to node ids that differ from the usual ones.
    """

    kind: Literal["sinumerik", "beckhoff"]
    enable: bool = False
    every_s: Annotated[float, Field(ge=1e-3, allow_inf_nan=False)] = 1.0
    largest_step_um: Annotated[float, Field(gt=0.0, le=1e6)] = 5.0
    axes: Annotated[dict[str, Count], Field(min_length=1)]
    nodes: dict[str, str] = Field(default_factory=dict)
    slopes: dict[str, SlopeSection] = Field(default_factory=dict)

    @property
    def control(self) -> Control:
        """Temperature compensation of this kind of control."""
        return CONTROLS[self.kind]

    def node(self, quantity: Quantity, axis: str) -> str:
        """Return the node id of a quantity of an axis of the offsets."""
        short = quantity.name.split()[0]
        return self.nodes.get(short, quantity.node).replace("{axis}", str(self.axes[axis]))


def writes_of(given: TargetFile, names: Iterable[str]) -> list[Write]:
    """Return the values written for some axes of the offsets: all offsets, then the slopes.

    For an axis with a slope, one write of either changes the compensation at the far end of the
    stroke by at most half of the largest step.
    """
    step, control, names = MICRO * given.largest_step_um, given.control, list(names)
    along = [(name, given.slopes[name]) for name in names if name in given.slopes]
    return [
        *(
            Write(control.offset, name, 0.5 * step if name in given.slopes else step)
            for name in names
        ),
        *(Write(control.slope, name, 0.5 * step / section.lever) for name, section in along),
    ]


def read_target(path: Path, output: OutputSettings | None = None) -> TargetFile:
    """Read the file of a target.

    Each axis of the offsets `output` needs an axis in the control, and writes that keep up with its
    rate.

    Raises
    ------
    InputError
        The file is missing or not TOML, a key or a name is unknown, a value is out of range, or an
        address is open to others without protection.
    """
    return target_from_data(toml.parse(toml.read_text(path, "target"), str(path)), path, output)


def target_from_data(
    data: dict[str, Any], path: Path, output: OutputSettings | None = None
) -> TargetFile:
    """Return a target given as nested dictionaries; raises as `read_target`."""
    given = settings_from(TargetFile, data, str(path), path.parent)
    check_protected(str(path), given)
    known = [one.name.split()[0] for one in given.control.quantities]
    for name in given.nodes:
        if name not in known:
            raise unknown_name("quantity", name, known, f"{path}: nodes")
    if len(set(given.axes.values())) < len(given.axes):
        raise InputError(f"{path}: axes: two have the same number; give each its own")
    for name in output.names if output else ():
        if name not in given.axes:
            raise unknown_name("axis", name, given.axes, f"{path}: axes")
    for name, section in given.slopes.items():
        if name not in given.axes:
            raise unknown_name("axis", name, given.axes, f"{path}: slopes")
        if not section.stroke_mm[0] < section.stroke_mm[1] or section.lever <= 0.0:
            raise InputError(f"{path}: slopes.{name}.stroke_mm: give its two ends in order")
    for quantity, name, most in writes_of(given, given.axes):
        if steps_in(quantity, most) < 1:
            raise InputError(
                f"{path}: largest_step_um {given.largest_step_um:g} is less than one step of "
                f"{quantity.name.split()[0]} of axis {name}; make it larger"
            )
    if output:
        _check_output(given, path, output)
    return given


def _check_output(given: TargetFile, path: Path, output: OutputSettings) -> None:
    """Refuse slopes missing in either the control or the offsets, and writes that lag behind."""
    own = {one.axis: one for one in output.slopes}
    for name in output.names:
        section, slope = given.slopes.get(name), own.get(name)
        if section is None and slope is not None:
            raise InputError(
                f"{path}: axis {name} takes no slope here, and has one in the offsets; add "
                f"[slopes.{name}] here, or leave it out there"
            )
        if section is not None and slope is None:
            raise InputError(
                f"{path}: slopes.{name}: axis {name} has no slope in the offsets; leave it out, or "
                f"add [axes.{name}.slope] there"
            )
        if section is None or slope is None:
            continue
        reference = given.control.reference
        if abs(section.reference - slope.reference) > reference.metres * reference.step:
            raise InputError(
                f"{path}: slopes.{name}.reference_mm {section.reference_mm:.9g} is not P0 of the "
                f"offsets, {slope.reference / MILLI:.9g} mm; change one of them"
            )
        low, high = (MILLI * end for end in section.stroke_mm)
        if low > slope.low + _ROUNDING or high < slope.high - _ROUNDING:
            raise InputError(
                f"{path}: slopes.{name}.stroke_mm is not all of the model's, "
                f"{slope.low / MILLI:.9g} to {slope.high / MILLI:.9g} mm; make it longer"
            )
    for quantity, name, most in writes_of(given, output.names):
        rate = output.rate
        if slope := own.get(name):
            rate = (slope.slope if quantity is given.control.slope else slope.offset).rate
        change = steps_in(quantity, most) * quantity.step * quantity.metres
        if change < rate * given.every_s * (1.0 - 1e-9):
            raise InputError(
                f"{path}: largest_step_um {given.largest_step_um:g} every_s {given.every_s:g} is "
                f"slower than rate_um_s {output.rate / MICRO:g} of the offsets; change one of them"
            )


def lines_of(given: TargetFile) -> Iterator[str]:
    """Yield the lines of a file for the control, with offsets of zero."""
    control = given.control
    yield f"{control.comment} {control.title}: temperature compensation by thermojoint"
    for axis, number in given.axes.items():
        if control.heading:
            yield control.heading.format(axis=number)
        values = {control.switch: 1.0}
        if section := given.slopes.get(axis):
            values[control.switch] = control.with_slope
            values[control.reference] = in_units(control.reference, section.reference)
        for quantity in (control.switch, control.offset, control.slope, control.reference):
            value = f"{values.get(quantity, 0.0):.10g}"
            unit = f" {control.comment} {quantity.unit}" if quantity.unit else ""
            yield quantity.line.format(axis=number, value=value) + unit
    yield from control.ending
