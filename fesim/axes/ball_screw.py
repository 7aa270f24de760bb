"""Ball screw: heat conduction, elongation, and tension between its bearings.

Heat is conducted along the screw, to the air through a uniform film, and through the bearings at
its ends to their seats. In finite volumes of equal width,

    C dT/dt = -K T - G (T - Ts) - h S (T - Ta) + q,

and because C and S are the same in every cell, K + G has the same modes for any film, which adds
h S/C to each rate. They are computed once; a step is exact for a constant film and constant heat
of each cell, both means over the step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh_tridiagonal

from fesim.march.exponential import phi_functions
from fesim.solid.materials import Material
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MILLI

#: Least length over which the heat of a longer travel is spread along a screw, m.
SHORTEST = MILLI


@dataclass(frozen=True)
class Rod:
    """A screw without thread."""

    #: Length between the bearings; diameter of the cross-section, m.
    length: float
    diameter: float
    material: Material

    @property
    def area(self) -> float:
        """Cross-section, m2."""
        return 0.25 * np.pi * self.diameter**2


@dataclass(frozen=True, eq=False)
class Conduction:
    """Conduction along a rod in n cells of equal width, and its modes."""

    #: Shape (n + 1,): edges of the cells, from 0 to the length, m.
    edges: Array
    #: Of a cell: heat capacity, J/K, and area to the air, m2.
    capacity: float
    surface: float
    #: Shape (2,): conductance of the first and the last cell to the seats of the bearings, W/K.
    sinks: Array
    #: Shape (2,): fraction of the heat at either end that reaches its cell; the rest goes straight
    #: to the seat.
    reaching: Array
    #: Shape (n,): decay rates of the modes without a film, 1/s.
    rates: Array
    #: Shape (n, n): orthonormal columns.
    modes: Array


@dataclass(frozen=True)
class Film:
    """Film h = still + added (v/speed)^exponent at speed v of the nut."""

    #: In still air, and added by motion, W/(m2 K).
    still: float
    added: float
    #: Speed of the nut at which the film is still + added, m/s.
    speed: float
    #: Positive.
    exponent: float


@dataclass(frozen=True)
class Heat:
    """Heat that enters a screw."""

    #: At the nut, J per m of its travel.
    nut: float
    #: Length of the nut, m.
    nut_length: float
    #: At the near and the far end, J per m of travel of the nut.
    bearings: tuple[float, float]
    #: At the near end, constant, W.
    motor: float


@dataclass(frozen=True)
class Hold:
    """Bearings that hold a screw."""

    #: Of the cold screw, N; 0 without pretension.
    tension: float
    #: Of the near and the far bearing, m/N.
    compliance: tuple[float, float]


@dataclass(frozen=True, eq=False)
class BallScrew:
    """A screw from its fixed bearing, at 0, to its far end."""

    #: Its shape and material.
    rod: Rod
    #: Conduction along it.
    conduction: Conduction
    #: Film to the ambient.
    film: Film
    #: Heat of nut, bearings and motor.
    heat: Heat
    #: Bearings at its ends.
    hold: Hold


@dataclass(frozen=True)
class Warmed:
    """A screw after a step, and the heat of the step."""

    #: Shape (n,): temperatures of the cells at its end, K.
    temperature: Array
    #: Mean heat that entered, was stored, and went to the air, W.
    entered: float
    stored: float
    given: float
    #: Shape (2,): mean heat that went to the seats of the bearings, W.
    seated: Array

    @property
    def balance(self) -> float:
        """Return the heat balance error, relative to the largest term."""
        parts = np.array([self.entered, -self.stored, -self.given, *-self.seated])
        largest = float(np.abs(parts).max())
        return float(parts.sum()) / largest if largest else 0.0


@dataclass(frozen=True)
class Beside:
    """Temperatures around a screw, means over a step, K."""

    #: Of the ambient.
    air: float
    #: Shape (2,): of the seats of the near and the far bearing.
    seats: Array


def conduction_along(rod: Rod, cells: int, ends: tuple[float, float]) -> Conduction:
    """Divide a rod into cells and find its modes.

    Parameters
    ----------
    rod : Rod
        The rod.
    cells : int
        Number of cells, two or more.
    ends : tuple of float
        Conductance of the bearings at both ends to their seats, W/K.
    """
    width = rod.length / cells
    across = rod.material.conductivity * rod.area / width
    capacity = rod.material.density * rod.material.heat_capacity * rod.area * width
    # From the centre of a cell to its end is half a width.
    reaching = 2.0 * across / (2.0 * across + np.array(ends))
    sinks = reaching * ends
    neighbours = np.full(cells, 2.0)
    neighbours[[0, -1]] = 1.0
    conducted = across * neighbours
    conducted[[0, -1]] += sinks
    rates, modes = eigh_tridiagonal(conducted / capacity, np.full(cells - 1, -across / capacity))
    return Conduction(
        edges=np.linspace(0.0, rod.length, cells + 1),
        capacity=capacity,
        surface=np.pi * rod.diameter * width,
        sinks=sinks,
        reaching=reaching,
        # The first rate of an insulated rod is zero, up to rounding.
        rates=np.maximum(rates, 0.0),
        modes=modes,
    )


def warmed(
    screw: BallScrew, temperature: Array, beside: Beside, times: Array, places: Array
) -> Warmed:
    """Take a step.

    Parameters
    ----------
    screw : BallScrew
        The screw.
    temperature : ndarray, shape (n,)
        Temperatures of its cells at the start, K.
    beside : Beside
        Temperatures around it.
    times, places : ndarray, shape (k,)
        Times from the start to the end of the step, s, between which the nut moves uniformly, and
        positions of its centre, m from the fixed bearing.
    """
    along, step = screw.conduction, float(times[-1] - times[0])
    film = film_over(screw.film, times, places)
    at_ends = heat_at_ends(screw.heat, times, places)
    heat = heat_of_nut(screw, times, places)
    entered = heat.sum() + at_ends.sum()
    seats = beside.seats - beside.air
    heat[[0, -1]] += along.reaching * at_ends + along.sinks * seats
    straight = (1.0 - along.reaching) * at_ends
    rates = along.rates + film * along.surface / along.capacity
    one, two, _ = phi_functions(rates * step)
    before = along.modes.T @ (temperature - beside.air)
    driven = along.modes.T @ (heat / along.capacity)
    change = step * one * (driven - rates * before)
    mean = along.modes @ (one * before + step * two * driven)
    risen = along.modes @ change
    seated = along.sinks * (mean[[0, -1]] - seats) + straight
    return Warmed(
        temperature=temperature + risen,
        entered=float(entered),
        stored=float(along.capacity * risen.sum() / step),
        given=float(film * along.surface * mean.sum()),
        seated=seated,
    )


def moved_so_far(
    made: BallScrew, way: tuple[float, float, float]
) -> tuple[BallScrew, tuple[float, float]]:
    """Return a screw and positions between which it has the heat and film of a longer travel, m.

    The positions are `SHORTEST` apart at least; the heat of the whole travel is spread uniformly
    between them.

    Parameters
    ----------
    made : BallScrew
        The screw.
    way : (float, float, float)
        Positions between which its nut moves uniformly, and its travel, to and fro, m.
    """
    start, end, gone = way
    if gone <= abs(end - start):
        return made, (start, end)
    if abs(end - start) < SHORTEST:
        middle = 0.5 * (start + end)
        start, end = middle - 0.5 * SHORTEST, middle + 0.5 * SHORTEST
    times, heat = gone / abs(end - start), made.heat
    near, far = heat.bearings
    heat = replace(heat, nut=times * heat.nut, bearings=(times * near, times * far))
    film = replace(made.film, speed=made.film.speed / times)
    return replace(made, heat=heat, film=film), (start, end)


def film_over(film: Film, times: Array, places: Array) -> float:
    """Return the mean film over a step of times and places (k,), W/(m2 K)."""
    lengths = np.diff(times)
    speeds = np.abs(np.diff(places)) / lengths
    share = (speeds / film.speed) ** film.exponent
    return film.still + film.added * float(lengths @ share) / float(lengths.sum())


def heat_at_ends(heat: Heat, times: Array, places: Array) -> Array:
    """Return the mean heat at the near and the far end (2,) over a step, W."""
    way = float(np.abs(np.diff(places)).sum())
    return np.array([heat.motor, 0.0]) + np.array(heat.bearings) * way / (times[-1] - times[0])


def heat_of_nut(screw: BallScrew, times: Array, places: Array) -> Array:
    """Return the mean heat of the nut in each cell (n,) over a step of times and places (k,), W.

    Heat is distributed over the length of the nut, in proportion to the travel.
    """
    edges, length = screw.conduction.edges, screw.heat.nut_length
    low, high = np.minimum(places[:-1], places[1:]), np.maximum(places[:-1], places[1:])
    passed = _below(edges[:, None] - low, length) - _below(edges[:, None] - high, length)
    return np.asarray(screw.heat.nut / (times[-1] - times[0]) * np.diff(passed.sum(axis=1)))


def _below(distance: Array, length: float) -> Array:
    """Integral of the fraction of a nut below a point, over the distance of the point ahead."""
    inside = np.clip(distance + 0.5 * length, 0.0, length)
    return inside**2 / (2.0 * length) + np.maximum(distance - 0.5 * length, 0.0)


def grown(screw: BallScrew, temperature: Array, at: Array) -> Array:
    """Return the free thermal elongation (..., k) from the fixed bearing to places, m.

    Parameters
    ----------
    screw : BallScrew
        The screw.
    temperature : ndarray, shape (..., n)
        Temperatures of its cells, K.
    at : ndarray, shape (..., k)
        Places, m from the fixed bearing; the elongation is constant beyond the ends.
    """
    edges = screw.conduction.edges
    strain = screw.rod.material.expansion * temperature * np.diff(edges)
    reach = np.concatenate([np.zeros_like(strain[..., :1]), np.cumsum(strain, axis=-1)], axis=-1)
    cells = edges.size - 1
    place = np.clip(at / (edges[-1] / cells), 0.0, cells)
    first = np.minimum(place.astype(np.int64), cells - 1)
    low, high = (np.take_along_axis(reach, one, axis=-1) for one in (first, first + 1))
    return np.asarray(low + (place - first) * (high - low))


def tension(screw: BallScrew, temperature: Array, apart: Array | float = 0.0) -> Array:
    """Return the tension of a screw, N, (..., k); it is slack at 0, as bearings only pull.

    Parameters
    ----------
    screw, temperature
        As for `grown`.
    apart : float or ndarray, shape (..., k)
        Distance by which the seats of its bearings have moved apart, m.
    """
    rod, hold = screw.rod, screw.hold
    if not hold.tension:
        return np.zeros(np.broadcast_shapes(np.shape(apart), (*temperature.shape[:-1], 1)))
    compliance = rod.length / (rod.material.youngs_modulus * rod.area) + sum(hold.compliance)
    ends = np.full((*temperature.shape[:-1], 1), rod.length)
    whole = grown(screw, temperature, ends)
    return np.maximum(hold.tension - (whole - apart) / compliance, 0.0)


def moved(screw: BallScrew, temperature: Array, at: Array, apart: Array | float = 0.0) -> Array:
    """Return the displacement of places away from the fixed bearing's seat, m, (..., k).

    It is relative to the cold screw under its own tension, and due to thermal elongation and loss
    of tension.

    Parameters
    ----------
    screw, temperature, apart
        As for `tension`.
    at : ndarray, shape (..., k)
        Places, m from the fixed bearing.
    """
    rod, hold = screw.rod, screw.hold
    lost = tension(screw, temperature, apart) - hold.tension
    per_newton = hold.compliance[0] + at / (rod.material.youngs_modulus * rod.area)
    return grown(screw, temperature, at) + lost * per_newton
