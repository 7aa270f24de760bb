"""A band of heat that moves along a guide: on a half-space and on a plate, against closed forms.

A band of half-width b that moves at speed v on an insulated half-space and supplies a heat flux q
causes, in the steady state, the temperature (Jaeger, Proc. R. Soc. N.S.W. 76, 1942)

    T(x) = q/(pi k) int_-b^b exp(-v (x - x')/(2 a)) K0(v |x - x'|/(2 a)) dx'

at the surface, x ahead of its middle; v b/(2 a) is its Peclet number. On a plate of thickness d
with a film h below, by the modes cos(beta_n z/d) of its depth, beta tan(beta) = h d/k,

    T(x) = q/(k d) sum_n int_-b^b exp(-v (x - x')/(2 a) - s_n |x - x'|) dx' / (2 s_n m_n),

    s_n^2 = (v/(2 a))^2 + (beta_n/d)^2,    m_n = 1/2 + sin(2 beta_n)/(4 beta_n)

(for the half-space the sum becomes an integral over all depths).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar
from scipy.special import k0e

from meshes.exchange import write_structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.moving_axis import (
    PRELOAD,
    RUNNING,
    on_axis,
    slide_case,
    slide_joint,
    slide_on_guide,
    write_course,
)
from thermojoint.verification.structures import IRON, marched

#: Width of the band and of the guide, m.
BAND, WIDE = 0.02, 0.1
#: Film through which the heat leaves, far from the band, W/m2K.
COLD = 1e4
#: Thickness of the plate, m, and the film below it, W/m2K.
PLATE, FILM = 0.01, 2000.0
#: Number of modes of the plate's depth in the sum.
MODES = 400
#: Steps in which the band passes a contact element; step sizes are extrapolated to zero.
PARTS = (2.0, 4.0)
_JAEGER = Quantity("temperature", "K", 1e-2, "Jaeger, closed form")
_MODES = Quantity("temperature", "K", 1e-2, "modes of the depth, closed form")
DIFFUSIVITY = IRON.conductivity / (IRON.density * IRON.heat_capacity)


@dataclass(frozen=True)
class Run:
    """Settings of the march for a band of some Peclet number; lengths in m."""

    #: Peclet number, v b/(2 a).
    peclet: float
    #: Length of a contact element and mesh size along the travel.
    along: float
    #: Travel of the band until the steady state.
    way: float
    #: Length of the guide before and behind the travel.
    margin: float
    #: Uppermost layer, number of layers and their growth; for a plate scaled to its depth.
    first: float
    layers: int
    growth: float

    @property
    def name(self) -> str:
        """Part of the name of its check."""
        return f"Peclet {self.peclet:g}"

    @property
    def depths(self) -> Array:
        """Ends of the layers, m."""
        ends = self.growth ** np.arange(self.layers + 1) - 1.0
        return np.asarray(self.first * ends / (self.growth - 1.0))

    @property
    def speed(self) -> float:
        """Speed of the band, m/s."""
        return 2.0 * DIFFUSIVITY * self.peclet / (0.5 * BAND)

    @property
    def flux(self) -> float:
        """Friction heat that enters the guide, W/m2."""
        return 0.5 * RUNNING * PRELOAD * self.speed


#: A slower band needs a longer travel and deeper layers; the film below a plate shortens it.
ON_HALF_SPACE = (
    Run(0.1, 0.004, 0.6, 0.15, 0.002, 17, 1.28),
    Run(1.0, 0.0025, 0.12, 0.04, 0.0006, 16, 1.28),
    Run(10.0, 0.001, 0.04, 0.01, 0.00012, 18, 1.28),
)
ON_PLATE = (
    Run(0.1, 0.005, 0.12, 0.06, 0.0003, 8, 1.36),
    Run(1.0, 0.0025, 0.08, 0.03, 0.0003, 8, 1.36),
    Run(10.0, 0.001, 0.04, 0.01, 0.0001, 12, 1.32),
)


def checks() -> Iterator[Check]:
    """Check bands on a half-space and on a plate."""
    with temporary_folder() as folder:
        for run in ON_HALF_SPACE:
            largest = _largest_marched(folder, run, run.depths, COLD)
            known = half_space_temperature(run.speed, run.flux)
            yield _JAEGER.check(f"moving band on a half-space, {run.name}", known, largest)
        for run in ON_PLATE:
            depths = run.depths * PLATE / run.depths[-1]
            largest = _largest_marched(folder, run, depths, FILM)
            known = plate_temperature(run.speed, run.flux)
            yield _MODES.check(f"moving band on a plate, {run.name}", known, largest)


def _largest_marched(folder: Path, run: Run, depths: Array, film: float) -> float:
    """The largest temperature that a point of the surface reaches, K."""
    margin = _graded(run.along, run.margin)
    uniform = margin[-1] + np.linspace(0.0, run.way + BAND, round((run.way + BAND) / run.along) + 1)
    grid = np.concatenate([margin, uniform[1:], uniform[-1] + (margin[-1] - margin[-2::-1])])
    began = float(margin[-1])
    lines = (grid, np.asarray(-depths[::-1], dtype=np.float64), np.array([0.0, WIDE]))
    count = round(BAND / run.along)
    slide = (began + np.linspace(0.0, BAND, count + 1), np.linspace(0.0, 0.01, 2))
    write_structure(slide_on_guide(lines, slide), folder / "band.vtu")
    joint = slide_joint(along=1, across=count, conductance={"law": "none"})
    data = slide_case("band.vtu", {"joint": joint | {"running_friction_coefficient": RUNNING}})
    data["materials"]["iron"]["expansion_1_K"] = 0.0
    data["heat_input"]["level"] = 0.0
    # Without a film above it, a reduced model would have to resolve the heating of the slide.
    data["convection_W_m2K"] = {"y0": film, "y1": COLD}
    data["supports"]["symmetry"] = {"z0": "z"}
    point = began + run.way - 2.0 * run.along
    data["probes"] = {"on": {"position_mm": [1e3 * point, 0.0, 500.0 * WIDE], "body": "guide"}}
    data["displacement"] = {"point": "on"}
    stroke = (round(1e3 * began, 6), round(1e3 * (began + run.way), 6))
    taken = run.way / run.speed
    course = write_course(folder, np.array([0.0, taken]), 1e-3 * np.array(stroke))
    data = on_axis(
        data, stroke, file=course, station_mm=1e3 * run.along, mesh_position_mm=stroke[0]
    )
    largest = []
    for part in PARTS:
        data["march"] = {"step_s": run.along / part / run.speed, "duration_min": taken / 60.0}
        largest.append(float(marched(folder, data)["temperature"].max()))
    return 2.0 * largest[1] - largest[0]


def _graded(first: float, length: float) -> Array:
    """Points of a margin from its far end to the travel, finest at the travel, m."""
    steps = [first]
    while sum(steps) < length:
        steps.append(1.3 * steps[-1])
    return np.round(np.concatenate([[0.0], np.cumsum(steps[::-1])]), 6)


def half_space_temperature(speed: float, flux: float) -> float:
    """Largest temperature under a band of given speed, m/s, and heat flux, W/m2, by Jaeger, K."""
    rate = speed / (2.0 * DIFFUSIVITY)

    def part(ahead: float) -> float:
        """k0e is exp(z) K0(z)."""
        far = rate * abs(ahead)
        return float(np.exp(-rate * ahead - far) * k0e(far))

    return flux / (np.pi * IRON.conductivity) * _largest(part)


def plate_temperature(speed: float, flux: float) -> float:
    """Largest temperature under a band on a plate, of given speed, m/s, and flux, W/m2, K."""
    rate = speed / (2.0 * DIFFUSIVITY)
    biot = FILM * PLATE / IRON.conductivity
    beta = np.array(
        [
            brentq(lambda z: z * np.sin(z) - biot * np.cos(z), np.pi * n, np.pi * (n + 0.5))
            for n in range(MODES)
        ]
    )
    decay = np.sqrt(rate**2 + (beta / PLATE) ** 2)
    weight = 1.0 / (2.0 * decay * (0.5 + np.sin(2.0 * beta) / (4.0 * beta)))

    def part(ahead: float) -> float:
        return float(weight @ np.exp(-rate * ahead - decay * abs(ahead)))

    return flux / (IRON.conductivity * PLATE) * _largest(part)


def _largest(part: Callable[[float], float]) -> float:
    """Largest value under the band of the integral of a line source's effect over the band."""

    def below(x: float) -> float:
        ends = (x - 0.5 * BAND, 0.0, x + 0.5 * BAND)
        return sum(quad(part, low, high, limit=200)[0] for low, high in pairwise(ends))

    found = minimize_scalar(lambda x: -below(x), bounds=(-0.5 * BAND, 0.5 * BAND), method="bounded")
    return -float(found.fun)
