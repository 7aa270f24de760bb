"""The verification suite: groups of checks in the order of printing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from thermojoint.verification import (
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
    """Checks that belong together.

    Attributes
    ----------
    title : str
        Heading in the table and on the docs page.
    run : callable
        Gives the checks.
    about : str
        Description of the comparison for the docs page; Markdown.
    """

    title: str
    run: Callable[[], Iterable[Check]]
    about: str = ""


def patch_tests() -> Iterator[Check]:
    """All patch tests."""
    yield from patch.heat_checks()
    yield from patch.elastic_checks()
    yield from patch.contact_checks()


#: All groups. Add a module's group here: Group("Barber's rod", rod.checks, "Description.").
GROUPS: tuple[Group, ...] = (
    Group(
        "Two bars in series through a joint",
        series.checks,
        "$q = A\\,\\Delta T / (L_1/k_1 + 1/h_c(p) + L_2/k_2)$: the temperatures of both ends "
        "are prescribed, and one time step is so long that it reaches the steady state. The "
        "pressure is the preload; the exact CMY model gives the conductance. The last rows "
        "have conductances other than Eq. 11: a fixed one, and air with radiation across a "
        "joint that starts 30 µm open.",
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
        "displacement by `fesim/solid/stress.py`. The 50.0 MPa of the benchmark are "
        "$E\\alpha T/2$, the stress in an unbounded plate. In the 20 mm square plate with free "
        "edges that the "
        "benchmark describes it is 50.446 MPa by a series solution, 0.9 % more. So there are two "
        "checks: the 20 mm plate against the series, and a plate of 80 mm, where the series "
        "gives 50.028 MPa, against 50.0 MPa. The elements are solid. They lie between two planes "
        "that hold $z$, with constants for which plane strain has the displacement and the "
        "in-plane stress of plane stress: $E(1+2\\nu)/(1+\\nu)^2$, $\\nu/(1+\\nu)$, "
        "$\\alpha(1+\\nu)/(1+2\\nu)$. Elements have straight edges, so the circle is a polygon "
        "of 96 sides; D is one of its corners.",
    ),
    Group(
        "NAFEMS LE11: cylinder, taper and sphere",
        le11.checks,
        "From a case file: a body of revolution starts at the temperature $r + z$ (m, K), "
        "with $E$ = 210 GPa, $\\nu$ = 0.3 and $\\alpha = 2.3 \\cdot 10^{-4}$/K; top and bottom "
        "remain in their planes. The axial stress at A = (1 m, 0) on the inside, unsmoothed, "
        "from the cell there, is compared with the benchmark's value, which has three digits. "
        "A quarter in curved second-order hexahedra: 4 through the wall, 5 around and 3 along "
        "each of four parts of the section, and 6, 6 and 4.",
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
    Group(
        "Barber's rod",
        rod.checks,
        "A rod of 0.1 m, one end built in and kept at 0, presses on a wall kept at $T_2$ (Barber, "
        "Dundurs and Comninou 1980). Its joint is that of two rough surfaces whose mean planes are "
        "20 µm apart when cold. *Growth and decay*: a steady state at the given opening of the "
        "joint is perturbed in the shape of a mode, by some mK, and the rate of the march is "
        "compared with $\\kappa z^2/L^2$, $z\\cosh z + Bi \\sinh z + b(\\cosh z - 1)/z = 0$, on "
        "both sides of both stability limits; the known error of implicit Euler is taken out. The "
        "joint's stiffness is in $b$. *Bistable*: with the wall at 25 K there are three steady "
        "states. All are found by following the condensed machine's response to a given contact "
        "pressure; the march comes to rest in two of them and leaves the middle one either way at "
        "the predicted rate.",
    ),
    Group(
        "Barber's rod from a case file",
        bistable.checks,
        "The same through the public interface: an aluminium rod, 20 µm away from a rigid "
        "wall of 24 K when cold, with air between (conductance $k_g/(Y + M)$ in parallel with "
        "Eq. 11) and no preload. The rod's balance in closed form has three steady states; "
        "all three are found with the machine's own response to a given conductance. A cold "
        "rod settles in the open state. A rod that starts at the temperatures of the middle "
        "state stays there for a while; perturbed by 1 %, it settles in one of the other two.",
    ),
    Group(
        "Mechanical loads",
        loaded.checks,
        "From case files, bars without lateral contraction: a column shortens under its "
        "weight by $\\rho g L^2/2E$; on a joint without preload, against a rigid wall, its "
        "foot presses with its weight; a force on two preloaded bars in series, applied by a "
        "history, changes the pressure of their joint by $F/A$, and the law of rough surfaces "
        "gives its approach.",
    ),
    Group(
        "Forces and stresses",
        bearing.checks,
        "From case files: the reaction and the joint force of a column of two bodies under "
        "its weight, a force from above and one from the side; the stress of a column under "
        "pressure; Lamé's stresses in a thick ring under internal pressure, at mid radius and "
        "at nodes of a snapshot, and the force in its section. 20 × 32 elements with straight "
        "edges over a quarter of the ring.",
    ),
    Group(
        "Bolts",
        bolted.checks,
        "From case files: bars without lateral contraction, clamped by a bolt between their "
        "ends. The contact force equals that of the bolt. A separating force $F$ changes the "
        "bolt's by $F k_b/(k_b + k_c)$ where everything is linear (one bar); in two bars, the "
        "joint between them, which only the bolt presses, is a spring by the law of rough "
        "surfaces. A steel bolt through an aluminium sleeve, both heated, gains $(\\alpha_s - "
        "\\alpha_b) L T / (1/k_b + 1/k_s)$.",
    ),
    Group(
        "Thermal fields",
        thermal_fields.checks,
        "From case files: the free decay of a cosine along a bar at the rate of its mode "
        "(1000 steps, 40 elements; full and reduced); warm bars between walls, which press on "
        "their joint from the start; heat proportional to $x$; a plate with a sine prescribed "
        "on one edge (32 × 32 elements).",
    ),
    Group(
        "Properties that depend on temperature",
        temperature_dependence.checks,
        "From case files, in closed form: Kirchhoff's transform for a conductivity that "
        "changes by half between the ends of a bar; heat loss by radiation, "
        "$\\varepsilon\\sigma(T^4 - T_a^4) = q$, or by temperature-dependent convection; a bar "
        "that expands by the integral of its coefficient; a thin plate that cools by such "
        "convection (1000 steps); two bars that face each other across enclosed air. *Last "
        "secant step*: the last change of temperature, relative to the largest temperature.",
    ),
    Group(
        "Two dissimilar rods",
        dissimilar_rods.checks,
        "Steel and aluminium between a hot and a cold wall, conductance growing with the square of "
        "the pressure. With the cold wall at −20 K the rods settle; at −36 K their only steady "
        "state is unstable and the pressure oscillates without end (Barber and Zhang 1988). The "
        "march, extrapolated from three time steps (1, 0.5 and 0.25 s; where it oscillates half of "
        "these), is compared at nine times up to 900 s with finite volumes in one dimension, "
        "integrated by an implicit Runge-Kutta method; shown is the time of the largest "
        "difference, relative to the range of the quantity.",
    ),
    Group(
        "Friction: a pressed block",
        friction.checks,
        "Two bodies so stiff that only the joint gives way, with $\\mu = 0.3$ and $k_t = 10^{12}$ "
        "Pa/m; one is driven obliquely to the joint's tangents, to three micro-slip lengths "
        "$\\mu p/k_t$ and back, twice. At 4.41 MPa the joint, whose preload is 1 MPa, is first "
        "pressed together. The work of the driving force and the dissipation in the joint (shear "
        "times slip) are computed apart. Led round a circle of radius $R = 2 \\mu p/k_t$, the "
        "slip follows on a circle of radius $r$ with $r^2 + (\\mu p/k_t)^2 = R^2$ and a round "
        "costs $2 \\pi r \\mu P$: 1440 steps, an error of first order in their length. What is "
        "to be zero is relative to $\\mu P$ or to the work of a cycle.",
    ),
    Group(
        "Partial slip of a strip",
        partial_slip.checks,
        "A strip of 300 mm × 1 mm × 20 mm, held at one end, on a rigid base: "
        "$E t u'' = \\tau(u)$, elastic up to $\\mu p$. Heated by 80 K it slips over three "
        "quarters of its length, cooled it slips back over a quarter; what has changed since the "
        "turn obeys the same equation with twice the limit. 120 hexahedra and 240 contact elements "
        "along the strip. The slip zone is counted in whole contact elements (1.25 mm).",
    ),
    Group(
        "The condensed march against a plain one",
        marching.condensed_checks,
        "Ten coupled steps of the staggered march beside one that condenses nothing: all "
        "temperatures and displacements as unknowns, every matrix factorised anew in every Newton "
        "iteration. Bars of iron and steel whose meshes do not match, heated on one side and then "
        "cooled until the joint opens, and half of the milling machine on 100 mm elements in steps "
        "of a minute; $\\mu = 0.1$. Both solve the gap equations to rounding. Shown is the worst "
        "step and place, relative to the largest value of the run. *Reduced march*: the milling "
        "machine once more on the modes that are a case's default, beside the same plain march. "
        "Its tolerance is what these modes are built to at 1 kW (0.2 mK, 0.4 nm of displacement, "
        "0.1 nm of gap; [reduction.md](reduction.md)) times the 4 kW of the run; of the pressure "
        "0.1 % of the largest.",
    ),
    Group(
        "Errors in the time step",
        marching.splitting_checks,
        "The bars of iron and steel under heat, from 0.2 MPa, so that the conductance grows a "
        "hundredfold. *Staggered less iterated*: difference of the two couplings at the same step. "
        "*March in dt*: difference of marches with one step length and with half of it. Steps of "
        "2, 1 and 0.5 s, compared at 48 s; the order is that between the two finest.",
    ),
)


@dataclass(frozen=True)
class Result:
    """Result of a group.

    Attributes
    ----------
    group : Group
        Group that was run.
    checks : tuple of Check
        Checks of the group.
    """

    group: Group
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
    """Return the check that fails because its group has raised an error."""
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
