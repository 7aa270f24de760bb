"""Ball screws and scales: heat along a screw, its elongation and tension, against closed forms.

A fin of length L with heat Q at one end has, once steady, with m^2 = 4 h/(k d),

    T(x) = Q cosh(m (L - x))/(k A m sinh(m L)),

and with a source Q that moves along an infinite fin at speed v, at a distance z behind the point,
with s^2 = (v/(2 a))^2 + m^2 (Rosenthal; Jaeger, Proc. R. Soc. N.S.W. 76, 1942)

    T(z) = Q/(2 k A s) exp(-v z/(2 a) - s |z|).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import quad

from fesim.axes.ball_screw import Beside, Warmed, moved, tension, warmed
from fesim.axes.occupation import stretches
from fesim.axes.positioning import (
    Drive,
    Screw,
    Surfaces,
    followed,
    positioning_error,
    scale_of,
    screw_of,
)
from fesim.case.drive_sections import BallScrewSection, ScaleSection
from fesim.case.history import History, step_history
from fesim.solid.materials import Material
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.moving_axis import (
    GUIDE,
    SHOWN,
    SLIDE,
    on_axis,
    slide_data,
    write_course,
)
from thermojoint.verification.structures import marched, material_section

STEEL = Material(
    conductivity=50.0,
    density=7850.0,
    heat_capacity=470.0,
    youngs_modulus=206e9,
    poisson_ratio=0.3,
    expansion=11.5e-6,
)
#: Length and diameter of the screw, position of its fixed bearing, m; film, W/(m2 K).
LENGTH, DIAMETER, START, FILM = 1.0, 0.04, -0.1, 40.0
AREA = 0.25 * math.pi * DIAMETER**2
DIFFUSIVITY = STEEL.conductivity / (STEEL.density * STEEL.heat_capacity)
#: Time constant of the film, s; decay along the fin, 1/m.
LASTING = STEEL.density * STEEL.heat_capacity * DIAMETER / (4.0 * FILM)
DECAY = math.sqrt(4.0 * FILM / (STEEL.conductivity * DIAMETER))
#: Stiffness of the screw and of its bearings, N/m; its stretch, m.
SCREW_STIFFNESS, NEAR, FAR = STEEL.youngs_modulus * AREA / LENGTH, 4e8, 6e8
STRETCH, RISE = 30e-6, 2.0
#: Position of an axis at which errors are compared, m; time to the steady state, s.
PLACE, STEADY = 0.45, 1e8
#: A screw without heat; keys of its ends are missing.
SECTION = {
    "bearings": "fixed-free",
    "nut_length_mm": 80.0,
    "diameter_mm": 1e3 * DIAMETER,
    "lead_mm": 10.0,
    "material": "steel",
    "film_W_m2K": FILM,
}
#: A screw that transfers heat to the slide and to both ends of the guide, but not to the air.
HEATING = {
    "bearings": "fixed-supported",
    "film_W_m2K": 0.0,
    "bearing_conductance_W_K": 5.0,
    "nut_share": 0.4,
    "bearing_share": 0.3,
    "far_bearing_torque_Nm": 0.3,
    "nut_surface": "tail",
    "bearing_surface": "x0",
    "far_bearing_surface": "x1",
}
NO_SEATS = np.full(3, -1)
NO_SURFACES = Surfaces(NO_SEATS, np.zeros((3, 0)))
ELONGATION = Quantity("positioning error", "µm", 1e-9)


def checks() -> Iterator[Check]:
    """Check ball screws and scales."""
    yield from _even_checks()
    yield from _tension_checks()
    yield from _fin_checks()
    yield from _nut_checks()
    yield _rotation_check()
    yield _lead_check()
    yield _scale_check()
    with temporary_folder() as folder:
        yield from _machine_checks(folder)


def screw_with(**keys: object) -> Screw:
    """Return a fixed-free screw with a film and without heat, modified by keys of its section."""
    ends = {"fixed_bearing_mm": 1e3 * START, "far_end_mm": 1e3 * (START + LENGTH)}
    return screw_of(BallScrewSection.model_validate(SECTION | ends | keys), STEEL)


def steps_of(
    screw: Screw, course: History, step: float, count: int, ambient: float
) -> list[Warmed]:
    """Return the steps of a screw that starts cold, while its axis moves, under one ambient, K."""
    taken, beside = [], Beside(ambient, np.full(2, ambient))
    temperature = np.zeros_like(screw.made.conduction.rates)
    for k in range(count):
        times, positions = stretches(course, k * step, (k + 1) * step)
        taken.append(warmed(screw.made, temperature, beside, times, screw.along(positions)))
        temperature = taken[-1].temperature
    return taken


def error_at(screw: Screw, temperature: Array, position: float = PLACE) -> float:
    """Return the positioning error of an axis with a screw, µm."""
    drive = Drive(screw, None, None, 0, None, NO_SURFACES, NO_SEATS)
    still = np.zeros((1, 3))
    return 1e6 * float(positioning_error(drive, temperature, np.array([position]), still)[0])


def _standing(screw: Screw, ambient: float, time: float = STEADY, count: int = 1) -> Array:
    """Temperatures after a time with the axis at rest, K."""
    still = step_history(PLACE)
    return steps_of(screw, still, time / count, count, ambient)[-1].temperature


def _even_checks() -> Iterator[Check]:
    """A screw warmed uniformly by the air, with the three bearing arrangements."""
    warm = 10.0 * (1.0 - math.exp(-1.0))
    free = 1e6 * STEEL.expansion * warm
    below = PLACE - START
    for name, keys, reference in (
        ("fixed-free", {}, free * below),
        ("fixed-supported", {"bearings": "fixed-supported"}, free * below),
        (
            "fixed-free, motor above",
            {"fixed_bearing_mm": 1e3 * (START + LENGTH), "far_end_mm": 1e3 * START},
            -free * (LENGTH - below),
        ),
    ):
        screw = screw_with(**keys)
        temperature = _standing(screw, 10.0, LASTING, 50)
        found = error_at(screw, temperature)
        yield ELONGATION.check(f"screw, {name}, evenly warm", reference, found)


def _tension_checks() -> Iterator[Check]:
    """A stretched screw between two fixed bearings, uniformly warm: stiff, compliant, slack."""
    grown = STEEL.expansion * RISE * LENGTH
    held = {"bearings": "fixed-fixed", "stretch_um": 1e6 * STRETCH}
    elastic = held | {
        "bearing_stiffness_N_um": 1e-6 * NEAR,
        "far_bearing_stiffness_N_um": 1e-6 * FAR,
    }
    compliance = 1.0 / SCREW_STIFFNESS + 1.0 / NEAR + 1.0 / FAR
    below = PLACE - START
    lost = grown / compliance
    left = grown * below - lost * (1.0 / NEAR + below / (STEEL.youngs_modulus * AREA))
    pull = Quantity("tension", "N", 1e-9)
    for name, keys, pulled, error in (
        ("stiff bearings", held, SCREW_STIFFNESS * (STRETCH - grown), 0.0),
        ("bearings that give", elastic, SCREW_STIFFNESS * STRETCH - lost, left),
    ):
        screw = screw_with(**keys)
        warm = _standing(screw, RISE)
        yield pull.check(f"screw, fixed-fixed, {name}", pulled, tension(screw.made, warm)[0])
        yield ELONGATION.check(
            f"screw, fixed-fixed, {name}", 1e6 * error, error_at(screw, warm), scale=1e6 * grown
        )
    screw = screw_with(**held)
    slack = _standing(screw, 2.0 * STRETCH / (STEEL.expansion * LENGTH))
    found = error_at(screw, slack)
    yield ELONGATION.check("screw, fixed-fixed, slack", 1e6 * STRETCH * below, found)


def _fin_checks() -> Iterator[Check]:
    """Heat at the motor: a steady fin, and one whose far bearing takes all of it."""
    heat, sink, warm = 20.0, 3.0, 6.0
    below = PLACE - START
    along = STEEL.conductivity * AREA
    fin = heat / (along * DECAY**2 * math.sinh(DECAY * LENGTH))
    fin *= math.sinh(DECAY * LENGTH) - math.sinh(DECAY * (LENGTH - below))
    reference = 1e6 * STEEL.expansion * fin
    errors = []
    for cells in (50, 100, 200):
        screw = screw_with(motor_heat_W=heat, cells=cells)
        errors.append(error_at(screw, _standing(screw, 0.0)) - reference)
    yield replace(ELONGATION, tolerance=1e-4).check(
        "screw, fin heated at its end", reference, reference + errors[1]
    )
    yield Quantity("order in space", "1", 0.02, "second order").check(
        "screw, fin heated at its end", 2.0, math.log2(errors[1] / errors[2])
    )
    time, near = 1000.0, 0.15
    screw = screw_with(motor_heat_W=heat, film_W_m2K=0.0)
    share = near / math.sqrt(4.0 * DIFFUSIVITY * time)
    beyond = (1.0 + 2.0 * share**2) * math.erfc(share)
    beyond -= 2.0 * share * math.exp(-(share**2)) / math.sqrt(math.pi)
    yield replace(ELONGATION, tolerance=1e-3, source="half-space under a flux, closed form").check(
        "screw, heat on its way along it",
        1e6 * STEEL.expansion * heat * DIFFUSIVITY * time / along * (1.0 - beyond),
        error_at(screw, _standing(screw, 0.0, time, 50), START + near),
    )
    keys = {"bearings": "fixed-supported", "film_W_m2K": 0.0, "bearing_conductance_W_K": sink}
    screw = screw_with(motor_heat_W=heat, **keys)
    # The heat to the far bearing passes through the whole screw, in which T is linear.
    far = (heat / sink + warm) / (2.0 / sink + LENGTH / along)
    mean = far / sink + far * (LENGTH - 0.5 * below) / along
    still = screw.along(np.full(2, PLACE))
    steady = warmed(
        screw.made,
        np.zeros_like(screw.made.conduction.rates),
        Beside(0.0, np.array([warm, 0.0])),
        np.array([0.0, STEADY]),
        still,
    )
    yield ELONGATION.check(
        "screw, heat between two bearings",
        1e6 * STEEL.expansion * mean * below,
        error_at(screw, steady.temperature),
    )


def _nut_checks() -> Iterator[Check]:
    """A nut that moves to and fro, and one that moves in one direction."""
    ends, period, torque = (0.1, 0.5), 10.0, 2.0
    turns = np.arange(0.0, 15.0 * LASTING, 0.5 * period)
    there = np.where(np.arange(turns.size) % 2, ends[1], ends[0])
    screw = screw_with(nut_torque_Nm=torque)
    steps = steps_of(screw, History(turns, there), 6.0 * period, int(14 * LASTING / 60.0), 0.0)
    heat = 2.0 * math.pi / 0.01 * torque * 2.0 * (ends[1] - ends[0]) / period
    yield replace(ELONGATION, tolerance=1e-4, source="time mean of the source, fin").check(
        "screw, nut to and fro",
        1e6 * STEEL.expansion * heat * _fin_under_nut(ends, PLACE - START),
        error_at(screw, steps[-1].temperature),
    )
    worst = max(abs(step.balance) for step in steps)
    yield Quantity("heat balance", "1", 1e-8).check("screw, nut to and fro", 0.0, worst, scale=1.0)
    yield _moving_source_check()


def _fin_under_nut(ends: tuple[float, float], to: float) -> float:
    """Integral of T from 0 to a place, per W of an 80 mm nut that moves between two places."""
    half = 0.04
    low, high = (end - START for end in ends)

    def density(x: float) -> float:
        covered = min(x + half, high) - max(x - half, low)
        return max(covered, 0.0) / (2.0 * half * (high - low))

    def grown(x: float) -> float:
        """Integral of the temperature from 0 to `to` due to 1 W at x."""
        near, far = min(x, to), max(x, to)
        m = DECAY
        whole = math.cosh(m * (LENGTH - x)) * math.sinh(m * near)
        beyond = math.sinh(m * (LENGTH - x)) - math.sinh(m * (LENGTH - far))
        whole += math.cosh(m * x) * beyond
        return whole / (STEEL.conductivity * AREA * m**2 * math.sinh(m * LENGTH))

    corners = sorted({low - half, low + half, high - half, high + half, to})
    inside = [x for x in corners if low - half < x < high + half]
    return quad(lambda x: density(x) * grown(x), low - half, high + half, points=inside)[0]


def _moving_source_check() -> Check:
    """Highest temperature of a long screw while the nut moves steadily in one direction."""
    speed, length, torque, step = 2e-4, 4.0, 20.0, 10.0
    screw = screw_with(
        far_end_mm=1e3 * (START + length), nut_torque_Nm=torque, nut_length_mm=80.0, cells=500
    )
    way = (0.5, 3.0)
    taken = (way[1] - way[0]) / speed
    course = History(np.array([0.0, taken]), np.array(way))
    last = steps_of(screw, course, step, round(taken / step), 0.0)[-1].temperature
    heat = 2.0 * math.pi / 0.01 * torque * speed
    rate = speed / (2.0 * DIFFUSIVITY)
    root = math.hypot(rate, DECAY)
    edges = screw.made.conduction.edges
    ahead = 0.5 * (edges[1:] + edges[:-1]) - float(screw.along(np.array(way[1])))

    def below(z: Array) -> Array:
        """Integral over z of exp(-rate z - root |z|)."""
        behind = np.exp(np.minimum(z, 0.0) * (root - rate)) / (root - rate)
        return behind - np.expm1(-np.maximum(z, 0.0) * (root + rate)) / (root + rate)

    scale = heat / (2.0 * STEEL.conductivity * AREA * root) / 0.08
    exact = scale * (below(ahead + 0.04) - below(ahead - 0.04))
    return Quantity("temperature", "K", 2e-3, "moving source on a fin, closed form").check(
        "screw, nut that moves on",
        float(exact.max()),
        float(last.max()),
        relative_error=float(np.abs(last - exact).max() / exact.max()),
    )


def _rotation_check() -> Check:
    """A screw in warm air that turns in one half of each step, with a stronger film meanwhile."""
    added, rpm, share = 60.0, 1000.0, 0.4
    keys = {"added_W_m2K": added, "rotation_rpm": rpm, "exponent": 0.7}
    screw = screw_with(rotating_film=keys)
    step, count = 30.0, 20
    # 0.01 m per turn, for half a step; back in the next one.
    way = 0.01 * share * rpm / 60.0 * 0.5 * step
    times = 0.5 * step * np.arange(2 * count + 1, dtype=np.float64)
    places = way * np.repeat(np.arange(count + 1, dtype=np.float64) % 2.0, 2)[1:]
    last = steps_of(screw, History(times, places), step, count, 10.0)[-1].temperature
    film = FILM + 0.5 * added * share**0.7
    warm = 10.0 * -math.expm1(-film / FILM * step * count / LASTING)
    return replace(ELONGATION).check(
        "screw, film that grows with rotation",
        1e6 * STEEL.expansion * warm * (PLACE - START),
        error_at(screw, last),
    )


def _lead_check() -> Check:
    """Twice the lead at twice the torque gives the same heat, and the error is the same."""
    course = History(np.array([0.0, 40.0, 80.0]), np.array([0.1, 0.6, 0.2]))
    found = []
    for times in (1.0, 2.0):
        screw = screw_with(lead_mm=10.0 * times, nut_torque_Nm=times, bearing_torque_Nm=times)
        last = steps_of(screw, course, 10.0, 8, 0.0)[-1].temperature
        found.append(error_at(screw, last))
    return replace(ELONGATION, source="half the lead, half the torque").check(
        "screw, twice the lead", *found
    )


def _scale_check() -> Check:
    """A scale beside a body that warms by 5 K, linearly in time, within one time constant."""
    section = ScaleSection(expansion_1_K=8e-6, fixed_mm=-50.0, head_mm=120.0, lag_s=900.0)
    made = scale_of(section)
    drive = Drive(None, made, None, 0, None, NO_SURFACES, NO_SEATS)
    warm = 0.0
    for k in range(30):
        warm = followed(made, warm, (k / 6.0, (k + 1.0) / 6.0), 30.0)
    at, still = np.array([PLACE]), np.zeros((1, 3))
    found = 1e6 * float(positioning_error(drive, np.array([warm]), at, still)[0])
    reference = 8.0 * 5.0 * math.exp(-1.0) * (0.05 + 0.12 + PLACE)
    return ELONGATION.check("scale that follows with a lag", reference, found)


def _machine_checks(folder: Path) -> Iterator[Check]:
    """A slide on a screw: its displacement less that of the slide alone is due to the screw."""
    data = slide_data(folder, SHOWN)
    data["materials"]["steel"] = material_section(STEEL)
    keys = {
        "fixed_bearing_mm": -200.0,
        "far_end_mm": 600.0,
        "nut_torque_Nm": 1.0,
        "bearing_torque_Nm": 0.5,
    }
    screw = screw_with(**keys)
    times, places = np.array([0.0, 100.0, 250.0, 300.0]), np.array([0.0, 0.3, 0.02, 0.2])
    stroke = (0.0, 1e3 * (GUIDE - SLIDE))
    course = write_course(folder, times, places)
    alone = marched(folder, on_axis(data, stroke, file=course))
    driven = marched(folder, on_axis(data, stroke, file=course, ball_screw=SECTION | keys))
    taken = steps_of(screw, History(times, places), 20.0, 15, 0.0)[-1].temperature
    made = screw.made
    moves = 1e6 * float((driven["displacement"] - alone["displacement"])[-1, 0])
    bending = 1e6 * float((driven["line_slope"] - alone["line_slope"])[-1, 0, 0])
    ends = moved(made, taken, screw.along(1e-3 * np.array(stroke)))
    yield replace(ELONGATION, source="the screw by itself").check(
        "screw, slide on a screw", error_at(screw, taken, float(places[-1])), moves
    )
    yield Quantity("tan β", "µm/m", 1e-9, "the screw by itself").check(
        "screw, slide on a screw", 1e9 * float(np.diff(ends)[0]) / (stroke[1] - stroke[0]), bending
    )
    yield from _seat_checks(folder, data, course)
    heating = SECTION | keys | HEATING
    response = marched(folder, on_axis(data, stroke, file=course, ball_screw=heating))
    along = screw_of(BallScrewSection.model_validate(heating), STEEL).made.conduction
    way = float(np.abs(np.diff(places)).sum())
    given = [name for name in response["source"].to_numpy() if str(name).startswith("x ")]
    left = 20.0 * float(response["source_power"].sel(source=given).sum())
    left += along.capacity * float(response["screw_temperature"][-1].sum())
    yield Quantity("heat", "J", 1e-9, "torques times angle").check(
        "screw, slide that its screw heats", 2.0 * math.pi / 0.01 * way * (1.0 + 0.5 + 0.3), left
    )


def _seat_checks(folder: Path, data: dict[str, Any], course: str) -> Iterator[Check]:
    """Seats moved by the guide, against their displacement recorded in another run."""
    stroke = (0.0, 1e3 * (GUIDE - SLIDE))
    seats = {"near": [100.0, -20.0, 0.0], "far": [320.0, -20.0, 0.0]}
    probes = {name: {"position_mm": at, "body": "guide"} for name, at in seats.items()}
    data = data | {"probes": data["probes"] | probes}
    near, far = (
        marched(folder, on_axis(data | {"displacement": {"point": name}}, stroke, file=course))
        for name in seats
    )
    scale = {"expansion_1_K": 0.0, "fixed_mm": 0.0, "seat": "near"}
    scaled = marched(folder, on_axis(data, stroke, file=course, scale=scale))
    source = "displacement of the seat"
    yield replace(ELONGATION, source=source).check(
        "scale, seat that moves",
        1e6 * float(near["displacement"][-1, 0]),
        1e6 * float(scaled["positioning_error"][-1, 0]),
    )
    screw = SECTION | {
        "bearings": "fixed-fixed",
        "fixed_bearing_mm": -200.0,
        "far_end_mm": 600.0,
        "pretension_kN": 5.0,
        "seat": "near",
        "far_seat": "far",
    }
    held = marched(folder, on_axis(data, stroke, file=course, ball_screw=screw))
    apart = float((far["displacement"] - near["displacement"])[-1, 0])
    yield Quantity("tension", "N", 1e-9, source).check(
        "screw, seats that move apart",
        5e3 + STEEL.youngs_modulus * AREA * apart / 0.8,
        float(held["screw_tension"][-1, 0]),
    )
