"""Barber's thermoelastic rod: growth rates of perturbations, and a rod with three steady states.

A rod 0 < x < L, built in and kept at 0 at x = 0, presses at x = L through a joint on a wall kept at
T2. It has no lateral strain (nu = 0), so it is one-dimensional. Barber, Dundurs and Comninou
(J. Appl. Mech. 47, 1980) examine when its steady state T = T_L x/L, T_L = T2 Bi/(1 + Bi),
Bi = h L/k, is stable:

- The joint passes -k T'(L) = h(p) (T_L - T2).
- Rod, joint and wall, L_w long, are springs in series: the opening of the joint since the preload
  is g = -alpha integral(T) + (p - p0) (L/E + L_w/E_w). For small changes, with s = -dp/dg, the
  pressure rises by E* alpha integral(T)/L with 1/E* = 1/E + L_w/(E_w L) + 1/(s L).
- A change exp(a t) sinh(z x/L), a = kappa z^2/L^2, satisfies the heat equation and the condition
  at x = 0. It causes the pressure E* alpha (cosh z - 1)/z. In the linearised joint,
  -k z cosh(z)/L = h sinh z + h'(p) (T_L - T2) E* alpha (cosh z - 1)/z, which is

      z cosh z + Bi sinh z + b (cosh z - 1)/z = 0,   b = h'(p) E* alpha L (T_L - T2)/k.

  For small z the left-hand side is z (1 + Bi + b/2), so that the rod is unstable if
  b < -2 (1 + Bi). Stable modes have z = i y: y cos y + Bi sin y + b (1 - cos y)/y = 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from scipy.optimize import brentq
from scipy.special import erfc

from fesim.joint.law import JointLaw, SurfaceNormalLaw, exact_conductance, harmonic_conductivity
from fesim.march.machine import CondensedMachine, State
from fesim.march.settling import initial_state
from fesim.march.stepping import iterated, march, staggered
from thermojoint.artefacts.arrays import Array
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.rods import NO_FRICTION, Rods, rods
from thermojoint.verification.solving import roots_on
from thermojoint.verification.structures import FOREVER, IRON, STEEL

LENGTH, WALL_LENGTH = 0.1, 0.02
ROD = replace(IRON, poisson_ratio=0.0)
WALL = replace(STEEL, poisson_ratio=0.0, expansion=0.0)
#: Displacement of the ends of rod and wall per pressure, m/Pa.
BACKING = LENGTH / ROD.youngs_modulus + WALL_LENGTH / WALL.youngs_modulus
DIFFUSIVITY = ROD.conductivity / (ROD.density * ROD.heat_capacity)
#: Time in which heat diffuses along the rod, s.
DIFFUSION = LENGTH**2 / DIFFUSIVITY
ELEMENTS = 60

#: Separation of the mean planes of the cold joint, its roughness, slope and hardness.
SEPARATION, ROUGHNESS, SLOPE, HARDNESS = 20e-6, 4e-6, 0.14, 1.961e9
#: Openings of steady states on both sides of both stability limits, m.
OPENINGS = (-0.5e-6, -1e-6, -4e-6, -6e-6, -7e-6, -7.4e-6, -8e-6)
#: Temperature of the wall at which the rod has three steady states, K, and their names.
BISTABLE = 25.0
STATES = ("open", "middle", "closed")
#: Time step and length of a simulation to a steady state, in diffusion times.
LONG, SETTLED = 0.05, 16.0
#: Approximate change of a mode in one step.
GROWTH = 0.1
#: Number of steps of the march away from a steady state, and number of steps before the rate is
#: measured.
STEPS, WAITING = 20, 10
#: Perturbation of the rod's end at the end of the measurement, K: small beside the 1 K by which the
#: pressure changes by half, large beside the tolerance of the gap equations (1e-6 K).
PERTURBATION = 2e-3

RATE = Quantity("growth rate", "1/s", 1e-2, "characteristic equation")
#: Pressure of a steady state, by continuation and as the final state of a march.
BALANCED = Quantity("contact pressure", "MPa", 1e-6, "balance of the rod")
MARCHED = replace(BALANCED, tolerance=1e-4)


@dataclass(frozen=True)
class Case:
    """A rod on a wall."""

    law: JointLaw
    #: T2, K.
    wall: float

    @property
    def inputs(self) -> Array:
        """Inputs of the march: the ambient, x = 0, and both sides of the wall, K."""
        return np.array([0.0, 0.0, self.wall, self.wall])

    def pressure(self, opening: float) -> float:
        """Pressure at an opening (m) of the joint, Pa."""
        return float(self.law.normal.pressure(np.array([opening]))[0])

    def biot(self, pressure: float) -> float:
        """Bi = h L/k."""
        conductance = float(self.law.conductance(np.array([pressure]))[0])
        return conductance * LENGTH / ROD.conductivity

    def misfit(self, opening: float) -> float:
        """Opening minus the opening of the steady state at the same pressure, m."""
        pressure = self.pressure(opening)
        biot = self.biot(pressure)
        growth = 0.5 * ROD.expansion * LENGTH * self.wall * biot / (1.0 + biot)
        return opening + growth - (pressure - self.law.preload) * BACKING

    def built(self) -> Rods:
        """Return the rod and its wall, which has a uniform temperature T2."""
        held = ["x0", "joint.b", "x1"]
        return rods((ROD, WALL), (LENGTH, WALL_LENGTH), (ELEMENTS, 1), self.law, held)


def leading_root(case: Case, opening: float) -> complex:
    """Root z of the leading mode about the steady state at `opening` (m).

    A real z is a growing mode. Without one it is i y with the first root y, which is below pi if
    -2 (1 + Bi) < b < pi^2/2.
    """
    pressure = case.pressure(opening)
    biot, part = case.biot(pressure), 1e-4 * pressure
    slope = (case.biot(pressure + part) - case.biot(pressure - part)) / (2.0 * part)
    stiffness = -float(case.law.normal.slope(np.array([opening]))[0])
    modulus = LENGTH / (BACKING + 1.0 / stiffness)
    b = slope * modulus * ROD.expansion * -case.wall / (1.0 + biot)

    def growing(z: float) -> float:
        # Divided by cosh z.
        return float(z + biot * np.tanh(z) + b * (1.0 - 1.0 / np.cosh(z)) / z)

    def decaying(y: float) -> float:
        return float(y * np.cos(y) + biot * np.sin(y) + b * (1.0 - np.cos(y)) / y)

    if b < -2.0 * (1.0 + biot):
        return complex(brentq(growing, 1e-3, 1.0 - b), 0.0)
    return complex(0.0, brentq(decaying, 1e-3, np.pi))


def joint_law() -> JointLaw:
    """Return the joint: plastic contact of two rough surfaces, barely touching when cold."""
    share = 0.5 * float(erfc(SEPARATION / (np.sqrt(2.0) * ROUGHNESS)))
    ends = (np.array([m.conductivity]) for m in (ROD, WALL))
    conductivity = float(harmonic_conductivity(*ends)[0])
    return JointLaw(
        SurfaceNormalLaw(HARDNESS, ROUGHNESS, share * HARDNESS),
        NO_FRICTION,
        exact_conductance(SLOPE, ROUGHNESS, conductivity, HARDNESS),
    )


def case_at(law: JointLaw, opening: float) -> Case:
    """Return the rod with a steady state at an opening (m): T2 is proportional to the growth."""
    still, heated = Case(law, 0.0), Case(law, 1.0)
    bare = still.misfit(opening)
    return Case(law, -bare / (heated.misfit(opening) - bare))


def balanced_openings(case: Case) -> list[float]:
    """Openings (m) of all steady states, the widest first, from the balance in the docstring."""
    return roots_on(np.linspace(0.0, -SEPARATION, 401), case.misfit, xtol=1e-20, rtol=1e-14)


def response(still: CondensedMachine, case: Case, pressure: float) -> State:
    """Steady state of the machine with the conductance of its joint at `pressure` (Pa).

    `still` has a time step of `FOREVER`.
    """
    given = replace(initial_state(still), pressure=np.array([pressure]))
    return next(march(still, lambda _: case.inputs, staggered, given)).state


def excess(still: CondensedMachine, case: Case, pressure: float) -> float:
    """Logarithm of the pressure of the `response` relative to the given pressure."""
    return float(np.log(response(still, case, pressure).pressure[0] / pressure))


def continued(still: CondensedMachine, case: Case) -> list[State]:
    """Find all steady states of the machine by following its response to the pressure."""
    grid = [case.pressure(opening) for opening in np.linspace(0.0, -0.6 * SEPARATION, 41)]
    pressures = roots_on(grid, lambda p: excess(still, case, p), rtol=1e-13)
    return [response(still, case, pressure) for pressure in pressures]


def steady_near(still: CondensedMachine, case: Case, opening: float) -> State:
    """Steady state of the machine near the balanced state at an opening (m)."""
    pressure = case.pressure(opening)
    ends = (0.99 * pressure, 1.01 * pressure)
    return response(still, case, brentq(lambda p: excess(still, case, p), *ends, rtol=1e-13))


def departure(
    built: Rods, case: Case, steady: State, root: complex, sign: float
) -> tuple[float, State]:
    """Perturb a steady state by the mode of `root` and march: its rate (1/s) and the last state.

    A perturbation of another shape would contain other modes.
    """
    rate = rate_of(root)
    machine = built.machine(GROWTH / abs(rate))
    size = sign * PERTURBATION * np.exp(-rate * STEPS * machine.thermal.step)
    rod = np.arange(built.x.size) < built.second
    mode = (np.sinh(root * built.x / LENGTH) / np.sinh(root)).real
    start = replace(
        initial_state(machine),
        temperature=steady.temperature + np.where(rod, size * mode, 0.0),
        gap=steady.gap,
        slip=steady.slip,
        pressure=steady.pressure,
    )
    steps = march(machine, lambda _: case.inputs, iterated, start)
    states = [step.state for step in islice(steps, STEPS)]
    end = int(np.argmax(np.where(rod, built.x, -np.inf)))
    left = [state.temperature[end] - steady.temperature[end] for state in states[WAITING:]]
    # Implicit Euler multiplies a mode by 1/(1 - a dt) in a step.
    factor = float(left[-1] / left[0]) ** (1.0 / (len(left) - 1))
    return (1.0 - 1.0 / factor) / machine.thermal.step, states[-1]


def rate_of(root: complex) -> float:
    """Rate a (1/s) of the mode of a root."""
    return (root**2).real / DIFFUSION


def settled(machine: CondensedMachine, case: Case, start: State) -> float:
    """Pressure (Pa) of the steady state that a simulation from `start` reaches."""
    steps = march(machine, lambda _: case.inputs, iterated, start)
    count = round(SETTLED / LONG)
    return float(next(islice(steps, count - 1, None)).state.pressure[0])


def checks() -> Iterator[Check]:
    """Check growth rates on both sides of the stability limits, and the bistable rod."""
    law = joint_law()
    built = Case(law, BISTABLE).built()
    still = built.machine(FOREVER)
    for opening in OPENINGS:
        case = case_at(law, opening)
        root = leading_root(case, opening)
        rate = rate_of(root)
        steady = steady_near(still, case, opening)
        computed, _ = departure(built, case, steady, root, 1.0)
        kind = "growth" if rate > 0.0 else "decay"
        at = f"wall at {case.wall:.1f} K, {1e6 * opening:g} um: {kind}"
        yield RATE.check(f"Barber's rod, {at}", rate, computed)
    yield from bistable_checks(built, still)


def bistable_checks(built: Rods, still: CondensedMachine) -> Iterator[Check]:
    """Three steady states by continuation; the march reaches two of them and leaves the third."""
    case = Case(built.law, BISTABLE)
    openings = balanced_openings(case)
    states = continued(still, case)
    expected = [case.pressure(opening) for opening in openings]
    for name, pressure, state in zip(STATES, expected, states, strict=True):
        title = f"Barber's rod, {name} state by continuation"
        yield BALANCED.check(title, 1e-6 * pressure, 1e-6 * state.pressure[0])
    long = built.machine(LONG * DIFFUSION)
    cold = initial_state(long)
    hot = replace(cold, temperature=case.wall * np.minimum(built.x / LENGTH, 1.0))
    root = leading_root(case, openings[1])
    ends = [("a cold rod", cold, expected[0]), ("a hot rod", hot, expected[2])]
    for way, sign, pressure in (("down", -1.0, expected[0]), ("up", 1.0, expected[2])):
        computed, end = departure(built, case, states[1], root, sign)
        yield RATE.check(f"Barber's rod, middle state left {way}wards", rate_of(root), computed)
        ends.append((f"the middle state, {way}wards", end, pressure))
    for name, start, pressure in ends:
        computed = 1e-6 * settled(long, case, start)
        yield MARCHED.check(f"Barber's rod, march from {name}", 1e-6 * pressure, computed)
