"""The verification suite: groups of checks in the order of printing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from thermojoint.verification import (
    adaptive_march,
    ball_screw,
    bearing,
    bistable,
    bolted,
    dissimilar_rods,
    friction,
    hot_spot,
    le11,
    loaded,
    manufactured,
    marching,
    moving_axis,
    moving_band,
    moving_load,
    nafems_heat,
    partial_slip,
    patch,
    rod,
    series,
    surface_model,
    temperature_dependence,
    thermal_fields,
)
from thermojoint.verification.check import Check


@dataclass(frozen=True)
class Group:
    """Checks that belong together."""

    #: Heading in the table and on the docs page.
    title: str
    #: Function that yields the checks.
    run: Callable[[], Iterable[Check]]


def patch_tests() -> Iterator[Check]:
    """Yield all patch tests."""
    yield from patch.heat_checks()
    yield from patch.elastic_checks()
    yield from patch.contact_checks()


#: All groups; their descriptions are in templates/about.md. Add a module's group to both.
GROUPS: tuple[Group, ...] = (
    Group("Two bars in series through a joint", series.checks),
    Group("Patch tests", patch_tests),
    Group("NAFEMS T1: membrane with a hot spot", hot_spot.checks),
    Group("NAFEMS LE11: cylinder, taper and sphere", le11.checks),
    Group("NAFEMS T3 and T4: heat conduction", nafems_heat.checks),
    Group("Manufactured solutions: observed orders", manufactured.checks),
    Group("Conductance of a joint", surface_model.checks),
    Group("Barber's rod", rod.checks),
    Group("Barber's rod from a case file", bistable.checks),
    Group("Mechanical loads", loaded.checks),
    Group("Forces and stresses", bearing.checks),
    Group("Bolts", bolted.checks),
    Group("Thermal fields", thermal_fields.checks),
    Group("Properties that depend on temperature", temperature_dependence.checks),
    Group("Two dissimilar rods", dissimilar_rods.checks),
    Group("Friction: a pressed block", friction.checks),
    Group("Partial slip of a strip", partial_slip.checks),
    Group("The condensed march against a plain one", marching.condensed_checks),
    Group("Errors in the time step", marching.splitting_checks),
    Group("Adaptive steps, pulses, units", adaptive_march.checks),
    Group("Moving axes", moving_axis.checks),
    Group("Bands of heat that move", moving_band.checks),
    Group("A beam under a moving load", moving_load.checks),
    Group("Ball screws", ball_screw.checks),
)


@dataclass(frozen=True)
class Result:
    """Result of a group."""

    #: The group.
    group: Group
    #: Checks of the group.
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether every check is within its tolerance."""
        return all(check.passed for check in self.checks)


def run(groups: Sequence[Group] = GROUPS) -> Iterator[Result]:
    """Run the groups in order, and yield each result.

    An error in a group becomes its last, failed check.
    """
    for group in groups:
        checks: list[Check] = []
        try:
            checks.extend(group.run())
        except Exception as error:
            checks.append(broken_off(group, error))
        yield Result(group, tuple(checks))


def broken_off(group: Group, error: Exception) -> Check:
    """Return the failed check of a group that has raised an error."""
    return Check(
        name=f"{group.title}: broken off",
        quantity="broken off",
        unit="1",
        reference=0.0,
        computed=math.nan,
        tolerance=1.0,
        source=f"{type(error).__name__}: {' '.join(str(error).split())}",
        scale=1.0,
    )
