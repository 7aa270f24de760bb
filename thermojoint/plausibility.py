"""Warnings about implausible values, with the unit that was probably intended.

Nothing here is an error: the ranges are those of engineering, not of physics. Zero is never
implausible; where it is not allowed, the schema refuses it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fesim.case.axis_section import seats_of
from fesim.case.history import read_samples
from fesim.case.schema import Case
from fesim.case.thermal_sections import SampledInput
from meshes.units import USUAL_SIZE
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.tables.columns import beginning

if TYPE_CHECKING:
    import xarray as xr

    from meshes.structure import Structure


@dataclass(frozen=True)
class Slip:
    """A unit that may have been used by mistake."""

    #: Name of the unit, as printed after the number.
    name: str
    #: factor * number + offset is the number in the expected unit.
    factor: float
    offset: float = 0.0
    #: Text after the converted number, if it is not the expected unit.
    into: str = ""


@dataclass(frozen=True)
class Quantity:
    """Plausible range of a quantity, and common mistakes of units."""

    #: The expected unit; empty for ratios.
    unit: str
    #: Plausible values.
    low: float
    high: float
    #: Typical value: of several slips that fit, the one that leads closest to it is suggested.
    typical: float
    #: Units that are commonly used by mistake.
    slips: tuple[Slip, ...] = ()


def _units(factors: Mapping[str, float]) -> tuple[Slip, ...]:
    """Return slips from the names of units and their factors."""
    return tuple(Slip(name, factor) for name, factor in factors.items())


_PERCENT, _KELVIN = Slip("%", 0.01), Slip("K", 1.0, -273.15)
_MICROMETRES = _units({"m": 1e6, "mm": 1e3, "nm": 1e-3})
_ABSOLUTE = Slip("K, as an absolute temperature,", 1.0, -293.15, "K above an ambient of 20 °C")

HEAT_INPUT = Quantity("times the reference step", -10.0, 10.0, 1.0, (_PERCENT,))
POWER = Quantity("W", 0.5, 1e5, 200.0, _units({"kW": 1e3, "mW": 1e-3, "µW": 1e-6, "MW": 1e6}))
PRESSURE = Quantity("MPa", 0.005, 2000.0, 4.0, _units({"Pa": 1e-6, "kPa": 1e-3, "GPa": 1e3}))
LENGTH = Quantity("mm", 1.0, 5e4, 300.0, _units({"m": 1e3, "µm": 1e-3}))
DIAMETER = Quantity("mm", 1.0, 300.0, 12.0, _units({"m": 1e3, "cm": 10.0}))
TORQUE = Quantity("N m", 1e-3, 200.0, 1.0, _units({"N mm": 1e-3, "N cm": 1e-2}))
EXPANSION = Quantity("1/K", -1e-4, 5e-4, 12e-6, _units({"1e-6/K": 1e-6, "mm/(m K)": 1e-3}))
#: Temperature of the air in a workshop.
AMBIENT = Quantity("°C", -40.0, 50.0, 20.0, (_KELVIN, Slip("°F", 5.0 / 9.0, -160.0 / 9.0)))
READING = Quantity("°C", -60.0, 250.0, 30.0, (_KELVIN,))
FILM = Quantity(
    "W/(m2 K)", 0.1, 1e5, 10.0, _units({"W/(mm2 K)": 1e6, "W/(cm2 K)": 1e4, "µW/(m2 K)": 1e-6})
)
#: Factor on a property, relative to its constant.
FACTOR = Quantity("times the constant", 0.05, 20.0, 1.0, (_PERCENT,))
#: Temperature rise above the ambient.
RISE = Quantity("K above ambient", -150.0, 250.0, 20.0, (_ABSOLUTE,))
#: The same at the start of a measurement.
RISE_AT_START = Quantity(
    "K above ambient at the start",
    -10.0,
    10.0,
    0.0,
    (
        _ABSOLUTE,
        Slip("°C as read", 1.0, -20.0, "K above an ambient of 20 °C"),
        Slip("°F as read", 5.0 / 9.0, -160.0 / 9.0 - 20.0, "K above an ambient of 20 °C"),
    ),
)
DISPLACEMENT = Quantity("m", -0.02, 0.02, 1e-4, _units({"µm": 1e-6, "mm": 1e-3}))
POSITION = Quantity("m", -50.0, 50.0, 0.5, _units({"mm": 1e-3, "µm": 1e-6}))
#: The longest side of a structure.
EXTENT = Quantity(
    "m",
    *USUAL_SIZE,
    0.5,
    _units({"read as m from a mesh in mm": 1e-3, "read as mm from a mesh in m": 1e3}),
)

#: Key of a case to its quantity; ``*`` matches any name or number.
CASE = {
    "materials.*.conductivity_W_mK": Quantity(
        "W/(m K)", 0.02, 2500.0, 45.0, _units({"mW/(m K)": 1e-3, "W/(cm K)": 1e2, "kW/(m K)": 1e3})
    ),
    "materials.*.density_kg_m3": Quantity(
        "kg/m3",
        20.0,
        2.3e4,
        7000.0,
        _units({"g/cm3": 1e3, "lb/in3": 27679.9, "kg/mm3": 1e9, "t/mm3": 1e12}),
    ),
    "materials.*.heat_capacity_J_kgK": Quantity(
        "J/(kg K)", 100.0, 5000.0, 500.0, _units({"kJ/(kg K)": 1e3, "cal/(g K)": 4186.8})
    ),
    # The reference machine has a screw of 2940 GPa, which stands for a screw of another shape.
    "materials.*.youngs_modulus_GPa": Quantity(
        "GPa", 0.2, 5000.0, 150.0, _units({"Pa": 1e-9, "MPa": 1e-3, "TPa": 1e3, "psi": 6.894757e-6})
    ),
    "materials.*.expansion_1_K": EXPANSION,
    "joints.*.preload_MPa": PRESSURE,
    "joints.*.reference_pressure_MPa": PRESSURE,
    "joints.*.initial_opening_um": Quantity("µm", 0.05, 2000.0, 20.0, _MICROMETRES),
    "joints.*.conductance.value_W_m2K": Quantity(
        "W/(m2 K)", 0.5, 1e7, 5000.0, _units({"W/(mm2 K)": 1e6, "W/(cm2 K)": 1e4, "kW/(m2 K)": 1e3})
    ),
    "joints.*.gap.gas_conductivity_W_mK": Quantity(
        "W/(m K)", 0.003, 1.0, 0.026, _units({"mW/(m K)": 1e-3, "W/(cm K)": 1e2})
    ),
    "joints.*.gap.temperature_jump_um": Quantity("µm", 0.01, 100.0, 0.4, _MICROMETRES),
    "joints.*.gap.mean_temperature_degC": Quantity("°C", -100.0, 1000.0, 30.0, (_KELVIN,)),
    "joints.*.gap.ambient_degC": Quantity("°C", -100.0, 1000.0, 20.0, (_KELVIN,)),
    "joints.*.roughness_um": Quantity("µm", 0.005, 200.0, 1.0, _MICROMETRES),
    "joints.*.asperity_slope": Quantity(
        "rad", 0.005, 2.0, 0.15, (Slip("degrees", math.pi / 180.0), _PERCENT, Slip("mrad", 1e-3))
    ),
    "joints.*.hardness_GPa": Quantity(
        "GPa", 0.02, 120.0, 2.0, _units({"kgf/mm2 (HB, HV)": 9.80665e-3, "MPa": 1e-3, "Pa": 1e-9})
    ),
    "joints.*.friction_coefficient": Quantity("", 0.0, 2.0, 0.2, (_PERCENT,)),
    "joints.*.tangential_stiffness_ratio": Quantity("", 0.05, 5.0, 0.8, (_PERCENT,)),
    "supports.springs.*.stiffness_N_um.*": Quantity(
        "N/µm", 1e-3, 1e5, 100.0, _units({"N/m": 1e-6, "N/mm": 1e-3, "kN/µm": 1e3})
    ),
    "convection_W_m2K.*": FILM,
    "cavities.*.film_W_m2K": FILM,
    "sources.*.reference_power_W": POWER,
    "heat_input.level": HEAT_INPUT,
    "heat_input.peak": HEAT_INPUT,
    "sources.*.heat_input.level": HEAT_INPUT,
    "sources.*.heat_input.peak": HEAT_INPUT,
    "held_temperatures.*.rise_K": RISE,
    "initial_temperature.rise_K": RISE,
    "materials.*.conductivity_factor.factor.*": FACTOR,
    "materials.*.heat_capacity_factor.factor.*": FACTOR,
    "materials.*.expansion_factor.factor.*": FACTOR,
    "materials.*.youngs_modulus_factor.factor.*": FACTOR,
    "convection_factor.*.factor.*": FACTOR,
    "radiation.*.ambient_degC": AMBIENT,
    "loads.*.force_N.*": Quantity("N", -1e7, 1e7, 1e3, _units({"mN": 1e-3, "µN": 1e-6, "kN": 1e3})),
    "loads.*.pressure_MPa": Quantity("MPa", -1000.0, 1000.0, 1.0, PRESSURE.slips[:2]),
    "loads.*.acceleration_m_s2.*": Quantity("m/s2", -1000.0, 1000.0, 9.81, (Slip("mm/s2", 1e-3),)),
    "bolts.*.force_kN": Quantity("kN", 0.01, 1e4, 20.0, _units({"N": 1e-3, "MN": 1e3})),
    "bolts.*.diameter_mm": DIAMETER,
    "bolts.*.clamped_length_mm": LENGTH,
    "bolts.*.stiffness_N_um": Quantity(
        "N/µm", 1.0, 1e5, 300.0, _units({"N/mm": 1e-3, "N/m": 1e-6})
    ),
    "axes.*.ball_screw.diameter_mm": DIAMETER,
    "axes.*.ball_screw.lead_mm": Quantity("mm", 0.5, 200.0, 10.0, _units({"m": 1e3, "µm": 1e-3})),
    "axes.*.ball_screw.film_W_m2K": FILM,
    "axes.*.ball_screw.rotating_film.added_W_m2K": FILM,
    "axes.*.ball_screw.rotating_film.rotation_rpm": Quantity(
        "1/min", 1.0, 2e4, 1000.0, _units({"1/s": 60.0, "rad/s": 30.0 / math.pi})
    ),
    "axes.*.ball_screw.nut_torque_Nm": TORQUE,
    "axes.*.ball_screw.bearing_torque_Nm": TORQUE,
    "axes.*.ball_screw.far_bearing_torque_Nm": TORQUE,
    "axes.*.ball_screw.stretch_um": Quantity("µm", 0.5, 1000.0, 30.0, _MICROMETRES),
    "axes.*.ball_screw.pretension_kN": Quantity("kN", 0.01, 500.0, 5.0, _units({"N": 1e-3})),
    "axes.*.scale.expansion_1_K": EXPANSION,
    "march.step_s": Quantity("s", 1e-3, 3600.0, 2.0, _units({"ms": 1e-3, "µs": 1e-6})),
    "march.duration_min": Quantity("min", 0.01, 2e4, 35.0, (Slip("s", 1.0 / 60.0),)),
    "structure.element_size_mm": LENGTH,
    "structure.joint_element_size_mm": LENGTH,
    "structure.dimensions_mm.*": LENGTH,
    "candidates.*.spacing_mm": LENGTH,
}


def implausible(place: str, value: float, quantity: Quantity) -> list[str]:
    """Return the warning about an implausible value; nothing if it is plausible."""
    if _plausible(value, quantity):
        return []
    unit = f" {quantity.unit}" if quantity.unit else ""
    text = f"{place} = {value:g} is implausible, usual is {quantity.low:g} to {quantity.high:g}"
    converted = [(slip, slip.factor * value + slip.offset) for slip in quantity.slips]
    slips = [
        (_distance(true, quantity.typical), slip, true)
        for slip, true in converted
        if _plausible(true, quantity)
    ]
    if not slips:
        return [f"{text}{unit}"]
    _, slip, true = min(slips, key=lambda slip: slip[0])
    into = f" {slip.into}" if slip.into else unit
    return [f"{text}{unit}; {value:g} {slip.name} would be {true:.5g}{into}"]


def _plausible(value: float, quantity: Quantity) -> bool:
    return value == 0.0 or quantity.low <= value <= quantity.high


def _distance(value: float, typical: float) -> float:
    """Distance of a value from the typical one: logarithmic where both are non-zero."""
    return abs(math.log(abs(value / typical))) if value and typical else abs(value - typical)


def of_case(case: Case, where: str) -> list[str]:
    """Return a warning for every implausible value of a case and its histories."""
    return of_cases([case], where)


def of_cases(cases: Iterable[Case], where: str) -> list[str]:
    """Return the warnings for several cases, one for each key, history and axis without a seat."""
    warnings: dict[str, list[str]] = {}
    quantities: dict[tuple[Path, str], Quantity] = {}
    lasting: dict[tuple[Path, str], float] = {}
    together: dict[tuple[Path, ...], float] = {}
    for case in cases:
        data = case.model_dump()
        for pattern, quantity in CASE.items():
            for place, value in _values(data, pattern.split(".")):
                if lines := implausible(f"{where}: {place}", value, quantity):
                    warnings.setdefault(place, lines)
        for place, line in _pointless(case):
            warnings.setdefault(place, [f"{where}: {place}: {line}"])
        quantities |= {(path, column): quantity for path, column, quantity in _histories(case)}
        files = list(_files_in_time(case))
        for read in files:
            lasting[read] = max(60.0 * case.march.duration_min, lasting.get(read, 0.0))
        paths, step = tuple(dict.fromkeys(path for path, _ in files)), case.march.step_s
        together[paths] = min(step, together.get(paths, step))
    return [
        *(line for lines in warnings.values() for line in lines),
        *(
            line
            for read, end in lasting.items()
            for line in _of_history(*read, quantities.get(read), end)
        ),
        *dict.fromkeys(line for files in together.items() for line in _begun_apart(*files)),
    ]


def _pointless(case: Case) -> Iterator[tuple[str, str]]:
    """Yield parts of a case that do not show what they are for, with the reason and a remedy."""
    moved = case.displacement
    if moved is not None and moved.point == moved.relative_to and moved.tool_mm is None:
        yield (
            "displacement",
            f"point and relative_to are both {moved.point!r}, between which nothing moves; name a "
            "probe on each side, or leave relative_to out",
        )
    for name in _adrift(case):
        yield (
            f"axes.{name}",
            "another axis carries it, but its drive has no seat, so it does not follow the growth "
            "of what carries it; name a probe there as the seat of its ball_screw or scale",
        )


def _adrift(case: Case) -> Iterator[str]:
    """Yield the axes that another axis carries and whose drives have no seat."""
    for name, axis in case.axes.items():
        carried = any(set(axis.bodies) < set(other.bodies) for other in case.axes.values())
        if carried and not any(seats_of(axis)):
            yield name


def _values(data: Any, pattern: Sequence[str]) -> Iterator[tuple[str, float]]:  # noqa: ANN401
    """Yield the key and value of every number that matches a pattern."""
    if not pattern:
        if isinstance(data, int | float):
            yield "", data
        return
    first, *rest = pattern
    parts = dict(enumerate(data)) if isinstance(data, list | tuple) else data
    for key in parts if isinstance(parts, dict) else ():
        if first in ("*", key):
            for place, value in _values(parts[key], rest):
                yield f"{key}.{place}".removesuffix("."), value


def _histories(case: Case) -> Iterator[tuple[Path, str, Quantity]]:
    for given in (case.heat_input, *(source.heat_input for source in case.sources.values())):
        if isinstance(given, SampledInput):
            yield given.file, "heat_input", HEAT_INPUT
    if case.ambient is not None:
        yield case.ambient.file, "ambient_degC", AMBIENT
    for held in case.held_temperatures.values():
        if held.file is not None:
            yield held.file, "rise_K", RISE


def _files_in_time(case: Case) -> Iterator[tuple[Path, str]]:
    """Yield every history of a case in a file, with its column."""
    yield from ((path, column) for path, column, _ in _histories(case))
    files = [(load.file, "factor") for load in case.loads.values()]
    files += [(bolt.file, "factor") for bolt in case.bolts.values()]
    files += [(axis.file, "position_mm") for axis in case.axes.values()]
    yield from ((path, column) for path, column in files if path is not None)


def _of_history(path: Path, column: str, quantity: Quantity | None, end: float) -> list[str]:
    """Return the warnings about a history in a march of `end` seconds, which is read once.

    An unreadable file is reported elsewhere.
    """
    try:
        samples = read_samples(path, column)
    except InputError:
        return []
    if not samples[0].size or not np.isfinite(samples).all():
        return []
    lines = [] if quantity is None else _in_another_unit(path, column, quantity, samples)
    return lines + _unused(path, column, end, samples)


def _in_another_unit(
    path: Path, column: str, quantity: Quantity, samples: tuple[Array, Array]
) -> list[str]:
    """Return the warning about a history with implausible values or swapped columns."""
    times, values = samples
    furthest = float(values[np.argmax(np.abs(values - quantity.typical))])
    lines = implausible(f"{path}: {column}", furthest, quantity)
    taken_for_values = all(_plausible(float(time), quantity) for time in times)
    if lines and values.size > 1 and taken_for_values and bool((np.diff(values) > 0.0).all()):
        return [
            f"{path}: the columns look swapped: {column} rises from {values[0]:g} to "
            f"{values[-1]:g} in every row, time_s only goes from {times[0]:g} to {times[-1]:g}"
        ]
    return lines


def _unused(path: Path, column: str, end: float, samples: tuple[Array, Array]) -> list[str]:
    """Return the warning about a history that does not change during a march of `end` seconds."""
    times, values = samples
    first, last = float(times[0]), float(times[-1])
    changes = np.ptp(values) > 0.0 and bool((np.diff(times) > 0.0).all())
    if not changes or (first < end and last > 0.0):
        return []
    stays = float(values[0] if first >= end else values[-1])
    return [
        f"{path}: {column} goes from {first:g} to {last:g} s, wholly outside the march from 0 to "
        f"{end:g} s, in which it stays at {stays:g}; count time_s from the start of the march"
    ]


def _begun_apart(paths: Sequence[Path], step: float) -> Iterator[str]:
    """Yield a warning for histories of a case whose first rows are more than a step, s, apart.

    Each counts from its own first row, so that what was read at one time would act at two.
    """
    if len(paths) < 2:
        return
    first: dict[str, tuple[Path, float]] = {}
    for path in paths:
        try:
            begun = beginning(path, "history")
        except InputError:
            continue
        if begun is None:
            continue
        other, moment = first.setdefault(begun[0], (path, begun[1]))
        later = begun[1] - moment
        if abs(later) > step:
            order = "later" if later > 0.0 else "earlier"
            yield (
                f"{path}: its first row is {abs(later):g} s {order} than that of {other}, and each "
                "history counts from its own first row; let both begin at the same time"
            )


def of_structure(structure: Structure, where: str) -> list[str]:
    """Return the warning about a structure of implausible size."""
    return implausible(
        f"{where}: longest side", float(np.ptp(structure.mesh.p, axis=1).max()), EXTENT
    )


def of_sample(sample: Mapping[str, float], where: str) -> list[str]:
    """Return a warning for every temperature of a row that probably has another unit."""
    lines = []
    for name, value in sample.items():
        if name == "ambient_degC":
            lines += implausible(f"{where}: {name}", value, AMBIENT)
        elif name.endswith("_degC"):
            lines += implausible(f"{where}: {name}", value, READING)
        elif name.endswith("_K"):
            lines += implausible(f"{where}: {name}", value, RISE)
    return lines


def of_response(response: xr.Dataset, where: str) -> list[str]:
    """Return a warning for every variable of a measured response that probably has another unit.

    Simulated responses, which contain their case, are not examined.
    """
    if "case" in response.attrs:
        return []
    lines = []
    if response["temperature"].size:
        start = float(np.median(response["temperature"].to_numpy()[0]))
        lines += implausible(f"{where}: temperature", start, RISE_AT_START)
        lines = lines or implausible(
            f"{where}: temperature", _largest(response["temperature"]), RISE
        )
    for name, quantity in (
        ("displacement", DISPLACEMENT),
        ("heat_input", HEAT_INPUT),
        ("probe_position", POSITION),
    ):
        if name in response and response[name].size:
            lines += implausible(f"{where}: {name}", _largest(response[name]), quantity)
    power = response.attrs.get("reference_power_W")
    if isinstance(power, int | float):
        lines += implausible(f"{where}: reference_power_W", float(power), POWER)
    return lines


def _largest(values: xr.DataArray) -> float:
    flat = values.to_numpy().ravel()
    return float(flat[np.argmax(np.abs(flat))])
