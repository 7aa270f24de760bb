"""File of a target (TOML): which control, how it is reached, and which of its axes move."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.settings import toml
from thermojoint.artefacts.settings.read import settings_from
from thermojoint.artefacts.settings.section import Count, Positive
from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.output import OutputSettings
from thermojoint.live.settings import OpcuaAddress, check_protected_url
from thermojoint.live.targets.beckhoff import BECKHOFF
from thermojoint.live.targets.control import Control, Quantity, in_units
from thermojoint.live.targets.sinumerik import SINUMERIK

CONTROLS: Mapping[str, Control] = {"sinumerik": SINUMERIK, "beckhoff": BECKHOFF}


class TargetFile(OpcuaAddress):
    """The whole file.

    ``axes`` gives for every axis of the offsets the number of the control's axis, ``nodes`` other
    node ids than the usual ones, by the name of the quantity.
    """

    kind: Literal["sinumerik", "beckhoff"]
    enable: bool = False
    every_s: Positive = 1.0
    largest_step_um: Positive = 5.0
    axes: Annotated[dict[str, Count], Field(min_length=1)]
    nodes: dict[str, str] = Field(default_factory=dict)

    @property
    def control(self) -> Control:
        """What the control takes."""
        return CONTROLS[self.kind]

    def node(self, quantity: Quantity, axis: str) -> str:
        """Return the node id of a quantity of an axis of the offsets."""
        short = quantity.name.split()[0]
        return self.nodes.get(short, quantity.node).replace("{axis}", str(self.axes[axis]))


def read_target(path: Path, output: OutputSettings | None = None) -> TargetFile:
    """Read the file of a target.

    Parameters
    ----------
    path : Path
    output : OutputSettings, optional
        The offsets: each needs its axis in the control, and writes that keep up with its rate.

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
    check_protected_url(str(path), given)
    known = [one.name.split()[0] for one in given.control.quantities]
    for name in given.nodes:
        if name not in known:
            raise unknown_name("quantity", name, known, f"{path}: nodes")
    if len(set(given.axes.values())) < len(given.axes):
        raise InputError(f"{path}: axes: two have the same number; give each its own")
    for name in output.names if output else ():
        if name not in given.axes:
            raise unknown_name("axis", name, given.axes, f"{path}: axes")
    if output and MICRO * given.largest_step_um < output.rate * given.every_s:
        raise InputError(
            f"{path}: largest_step_um {given.largest_step_um:g} every_s {given.every_s:g} is "
            f"slower than rate_um_s {output.rate / MICRO:g} of the offsets; change one of them"
        )
    return given


def lines_of(given: TargetFile, metres: Mapping[str, float]) -> Iterator[str]:
    """Yield the lines of a file for the control, with offsets by axis (m)."""
    control = given.control
    yield f"{control.comment} {control.title}: temperature compensation by thermojoint"
    for axis, number in given.axes.items():
        if control.heading:
            yield control.heading.format(axis=number)
        values = {control.switch: 1.0, control.offset: in_units(control.offset, metres[axis])}
        for quantity in (control.switch, control.offset, *control.zeros):
            value = f"{values.get(quantity, 0.0):.10g}"
            unit = f" {control.comment} {quantity.unit}" if quantity.unit else ""
            yield quantity.line.format(axis=number, value=value) + unit
    yield from control.ending
