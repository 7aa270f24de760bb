"""Common interface of estimators: channels in, displacement out, sample by sample.

Estimators are immutable: everything that a sample changes is in the state, a plain array whose
first entry is the time of the last sample (NaN before the first). So a state can be stored, copied
and restored bit for bit, and one estimator serves any number of machines of the same kind.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from enum import IntFlag, auto
from typing import NamedTuple, Protocol

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ThermojointError

#: Default standard deviation of a displacement reading, m.
READING_NOISE = 0.5e-6
#: Added to a status in words: no recent sample, or one without any reading.
SILENT = "silent"


class Status(IntFlag):
    """Status of an estimate: ``ok``, or reasons for reduced certainty.

    Beyond: outside the calibrated range. Unsettled: an unknown start or missing readings still have
    an effect. Distrusted: a sensor is excluded because it contradicts the others or the model.
    Reading refused: a displacement reading was inconsistent and was not used. Readings lost: so
    much has been missing for so long that the estimate is little more than a guess; its quality is
    bad.
    """

    OK = 0
    BEYOND_TIME = auto()
    BEYOND_HEAT = auto()
    BEYOND_TEMPERATURE = auto()
    READING_MISSING = auto()
    UNSETTLED = auto()
    SENSOR_DISTRUSTED = auto()
    BEYOND_DISPLACEMENT = auto()
    READING_REFUSED = auto()
    READINGS_LOST = auto()

    @property
    def reasons(self) -> list[str]:
        """The reasons alone, e.g. ``["beyond-time", "beyond-heat"]``."""
        return [(flag.name or "").lower().replace("_", "-") for flag in Status if flag in self]

    @property
    def words(self) -> str:
        """``ok``, or the reasons, e.g. ``beyond-time beyond-heat``."""
        return " ".join(self.reasons) or "ok"


class Channel(NamedTuple):
    """A number in a sample or in an estimate.

    Attributes
    ----------
    name : str
        E.g. ``delta_T``.
    unit : str
        In SI, ``1`` if it has none.
    occasional : bool
        Whether it is read now and then, as by a touch probe; those are the last of a sample.
    """

    name: str
    unit: str
    occasional: bool = False


class Estimate(NamedTuple):
    """Output of an estimator at one sample.

    Attributes
    ----------
    time : float
        s.
    displacement : ndarray, shape (axes,)
        δ, m.
    band : ndarray, shape (axes,)
        Half-width of the 95 % interval of δ, m; NaN if the estimator has none.
    status : Status
        Reliability of the estimate.
    details : ndarray, shape (details,)
        The estimator's own `details`.
    missing, distrusted : tuple of str
        Channels that were empty, and channels with a value that were excluded.
    silent : bool
        Whether the sample had no reading but occasional ones, as `follow` notes it.
    """

    time: float
    displacement: Array
    band: Array
    status: Status
    details: Array
    missing: tuple[str, ...] = ()
    distrusted: tuple[str, ...] = ()
    silent: bool = False

    @property
    def words(self) -> str:
        """The status in words, with the channels concerned: ``sensor-distrusted:T1,T2``."""
        named = {"reading-missing": self.missing, "sensor-distrusted": self.distrusted}
        words = [
            f"{reason}:{','.join(named[reason])}" if named.get(reason) else reason
            for reason in self.status.reasons
        ]
        words += [SILENT] * self.silent
        return " ".join(words) or "ok"


class NextReading(NamedTuple):
    """A displacement reading that an estimator requests."""

    #: To be read.
    axis: str
    #: Time from now at which the band passes its limit if the heat stays as it is, s.
    due: float
    #: Half-widths of the 95 % interval of this axis then, without the reading and after it, m.
    band: float
    narrowed: float


class Estimator(Protocol):
    """Protocol of estimators."""

    @property
    def kind(self) -> str:
        """Name of the kind, e.g. ``fchs``."""
        ...

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        ...

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Contents of a sample, in order."""
        ...

    @property
    def details(self) -> tuple[Channel, ...]:
        """Contents of an estimate beside displacement, band and status."""
        ...

    def initial_state(self) -> Array:
        """Return the state of a machine at rest, before any sample."""
        ...

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; the given state is not modified.

        Parameters
        ----------
        state : ndarray
            State after the previous sample, or the initial state.
        time : float
            s; later than that of the previous sample.
        values : sequence of float
            In the order of `channels`.

        Raises
        ------
        InputError, ConvergenceError
            Time does not increase, a value is unusable, or a solver does not reach its tolerance.
            The state can be used again.
        """
        ...


def facts_of(estimator: Estimator) -> dict[str, str]:
    """Return what represents an estimator in short: its axes and its channels."""
    channels = ", ".join(f"{channel.name} in {channel.unit}" for channel in estimator.channels)
    return {"axes": ", ".join(estimator.axes), "channels": channels}


def follow(
    estimator: Estimator, samples: Iterable[Sequence[float]], state: Array
) -> Iterator[tuple[Array, Estimate]]:
    """Yield (state, estimate) for each of a sequence of samples.

    Parameters
    ----------
    estimator : Estimator
        Of any kind.
    samples : iterable of sequences
        Time (s) and the value of each channel.
    state : ndarray
        Before the first of them.

    Raises
    ------
    InputError, ConvergenceError
        As `Estimator.sample`, with the number of the sample (from 0) and its time.
    """
    wanted = sum(not channel.occasional for channel in estimator.channels)
    for index, (time, *values) in enumerate(samples):
        try:
            state, estimate = estimator.sample(state, time, values)
        except ThermojointError as error:
            raise type(error)(f"sample {index} at {time:.15g} s: {error}") from error
        heard = any(map(math.isfinite, values[:wanted]))
        yield state, estimate if heard else estimate._replace(silent=True)
