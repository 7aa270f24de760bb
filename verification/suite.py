"""The verification suite: its groups in the order they are printed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from verification import hot_spot, manufactured, nafems_heat, patch, series, surface_model
from verification.check import Check


@dataclass(frozen=True)
class Group:
    """Checks that belong together.

    Attributes
    ----------
    title : str
        Heading in the table and on the docs page.
    run : callable
        Gives the checks.
    about : str
        What is compared with what, for the docs page; Markdown.
    """

    title: str
    run: Callable[[], Iterable[Check]]
    about: str = ""


def patch_tests() -> Iterator[Check]:
    """All patch tests."""
    yield from patch.heat_checks()
    yield from patch.elastic_checks()
    yield from patch.contact_checks()


#: All groups. Add a module's group here: Group("Barber's rod", rod.checks, "What it compares.").
GROUPS: tuple[Group, ...] = (
    Group(
        "Two bars in series through a joint",
        series.checks,
        "$q = A\\,\\Delta T / (L_1/k_1 + 1/h_c(p) + L_2/k_2)$: held temperatures at both ends, one "
        "step of the march so long that it ends in the steady state. The preload is the pressure; "
        "the exact CMY model gives the conductance.",
    ),
    Group(
        "Patch tests",
        patch_tests,
        "Inner nodes are moved by up to a fifth of the spacing. The error is that of the worst "
        "node, cell or contact element, relative to the largest value of the exact field; "
        "*reference* and *computed* are the values there. The contact patch test presses two "
        "hot bars against each other between two walls; their meshes do not match at the joint.",
    ),
    Group(
        "NAFEMS T1: membrane with a hot spot",
        hot_spot.checks,
        "A disc of radius 1 mm with $\\alpha T = 10^{-3}$ in a cold plate, plane stress. "
        "Compared is $\\sigma_{yy}$ at D = (1 mm, 0), on the cold side, recovered from the "
        "displacement by `fesim/stress.py`. The 50.0 MPa of the benchmark are $E\\alpha T/2$, "
        "the stress in an unbounded plate. In the 20 mm square plate with free edges that the "
        "benchmark describes it is 50.446 MPa by a series solution, 0.9 % more. So there are two "
        "checks: the 20 mm plate against the series, and a plate of 80 mm, where the series "
        "gives 50.028 MPa, against 50.0 MPa. The elements are solid. They lie between two planes "
        "that hold $z$, with constants for which plane strain has the displacement and the "
        "in-plane stress of plane stress: $E(1+2\\nu)/(1+\\nu)^2$, $\\nu/(1+\\nu)$, "
        "$\\alpha(1+\\nu)/(1+2\\nu)$. Elements have straight edges, so the circle is a polygon "
        "of 96 sides; D is one of its corners.",
    ),
    Group(
        "NAFEMS T3 and T4: heat conduction",
        nafems_heat.checks,
        "T3, a bar of 0.1 m whose one end is held at 0 and the other at $100 \\sin(\\pi t/40)$: "
        "80 elements along it and steps of 0.05 s (40 and 0.1 s leave 0.25 %, 10 and 0.4 s 2.3 "
        "%). T4, a plate of 0.6 m × 1 m with its base held at 100 and two sides in air: 60 × 100 "
        "elements.",
    ),
    Group(
        "Manufactured solutions: observed orders",
        manufactured.checks,
        "A sine wave in space, with the body heat or force that it needs and its values on the "
        "boundary of a cube, on three meshes each; the order is that between the two finest. "
        "Heat: 4, 8, 16 elements along an edge; elasticity: 4, 6, 8. Displacement under a thermal "
        "strain has order 2, not 3: temperatures are of first order, their error does not change "
        "sign within an element, and the displacement inherits it. The grids are bent smoothly: "
        "serendipity hexahedra lose an order on meshes that stay distorted however fine they are. "
        "Time step: a mode of the discrete heat equation, 50, 100 and 200 steps.",
    ),
    Group(
        "Conductance of a joint",
        surface_model.checks,
        "$h_c\\sigma/(k_h m)$ of the exact model of Cooper, Mikic and Yovanovich (CMY), the "
        "deviation of the two power laws from it (error relative to the exact model), and $h_c$ of "
        "the paper's joint, $p/H = 2.2485 \\cdot 10^{-3}$. Tolerances are half of the reference's "
        "last digit.",
    ),
)


@dataclass(frozen=True)
class Result:
    """A group that has run.

    Attributes
    ----------
    group : Group
        What ran.
    checks : tuple of Check
        What came out.
    """

    group: Group
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether every check is within its tolerance."""
        return all(check.passed for check in self.checks)


def run(groups: Sequence[Group] = GROUPS) -> Iterator[Result]:
    """Run one group after another, and yield each as it ends."""
    for group in groups:
        yield Result(group, tuple(group.run()))
