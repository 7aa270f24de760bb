"""Properties of the instruments of a test: limits of error, drift, holder, repeated tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from thermojoint.artefacts.settings.read import read_settings
from thermojoint.artefacts.settings.section import NotNegative, Positive, Section
from thermojoint.artefacts.units import MICRO, MILLI


@dataclass(frozen=True)
class Known:
    """A value in SI, and its origin."""

    value: float
    basis: str


@dataclass(frozen=True)
class Holder:
    """Holder of a probe."""

    #: Displacement of the probe per temperature of the holder, m/K: length times expansion.
    growth: float
    #: Range of its temperature in the test, K, or the channel of the record with its temperature.
    rise: float | str
    #: Origin of these values.
    basis: str


@dataclass(frozen=True)
class Instruments:
    """The instruments of a test."""

    #: Limit of the error of a reading, m, K.
    probe: Known = Known(0.5e-6, "assumed, 0.1 % of a measuring range of 0.5 mm")
    thermometer: Known = Known(0.2, "assumed, Pt100 of class A (IEC 60751) near 25 °C")
    #: Range of a probe's reading over a time like the test's while its target does not move, m.
    drift: Known = Known(0.5e-6, "assumed, as large as the error; no drift test was given")
    #: Limit of the error of the distance between two probes, m.
    distance: Known = Known(0.5e-3, "assumed, read from a steel rule")
    #: Quantity to standard deviation of a parameter over repeated tests, m, rad, K; without it, the
    #: scatter of the readings counts.
    repeat: Mapping[str, Known] = field(default_factory=dict)
    #: None neglects its expansion.
    holder: Holder | None = None


class _ProbeSection(Section):
    """``[probe]``."""

    error_um: NotNegative | None = None
    drift_um: NotNegative | None = None
    distance_error_mm: NotNegative | None = None


class _ThermometerSection(Section):
    """``[thermometer]``."""

    error_K: NotNegative | None = None


class _HolderSection(Section):
    """``[holder]``: its rise is a range of temperature, or the name of one in the record."""

    length_mm: Positive
    expansion_1_K: Positive
    rise_K: NotNegative | str


class _RepeatSection(Section):
    """``[repeat]``."""

    displacement_um: NotNegative | None = None
    tilt_um_per_m: NotNegative | None = None
    temperature_K: NotNegative | None = None


class InstrumentsFile(Section):
    """A whole file of instruments."""

    probe: _ProbeSection = _ProbeSection()
    thermometer: _ThermometerSection = _ThermometerSection()
    holder: _HolderSection | None = None
    repeat: _RepeatSection = _RepeatSection()


def read_instruments(path: Path) -> Instruments:
    """Read the instruments of a test (TOML); missing values are taken from `Instruments`.

    Raises
    ------
    InputError
        The file is missing or not TOML, a key is unknown, or a value is out of range.
    """
    given = read_settings(InstrumentsFile, path, "file of instruments")
    values = {
        "probe": (given.probe.error_um, MICRO),
        "drift": (given.probe.drift_um, MICRO),
        "distance": (given.probe.distance_error_mm, MILLI),
        "thermometer": (given.thermometer.error_K, 1.0),
    }
    repeat = {
        "displacement": (given.repeat.displacement_um, MICRO),
        "tilt": (given.repeat.tilt_um_per_m, MICRO),
        "temperature": (given.repeat.temperature_K, 1.0),
    }
    holder = given.holder
    return Instruments(
        **_known(values, path.name),
        repeat=_known(repeat, f"{path.name}: repeated tests"),
        holder=None
        if holder is None
        else Holder(MILLI * holder.length_mm * holder.expansion_1_K, holder.rise_K, path.name),
    )


def _known(given: Mapping[str, tuple[float | None, float]], basis: str) -> dict[str, Known]:
    return {
        name: Known(factor * value, basis)
        for name, (value, factor) in given.items()
        if value is not None
    }
