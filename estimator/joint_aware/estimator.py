"""Joint-aware estimator with the common interface: predict, gate, correct, solve, evaluate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from estimator.interface import READING_NOISE, Channel, Estimate, facts_of
from estimator.joint_aware import initial_states, whole_runs
from estimator.joint_aware.channels import estimate_details
from estimator.joint_aware.compiled_sample import Results
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_model import SCHEMA, Kind, ObserverModel
from estimator.joint_aware.observer_state import Layout
from estimator.joint_aware.precomputed import Precomputed
from estimator.joint_aware.sample_estimate import estimate_of
from estimator.joint_aware.sample_processing import process
from estimator.joint_aware.sample_values import cold_ambient, split_sample
from estimator.joint_aware.thresholds import USUAL, Thresholds
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.display import Described


@dataclass(frozen=True, eq=False, repr=False)
class JointAware(Described):
    """Observer of the machine's reduced physics and joint, corrected by the available readings.

    A channel that is NaN is ignored. `warm_state` is for a machine with an unknown past,
    `initial_state` for one at rest at ambient temperature.

    Attributes
    ----------
    model : ObserverModel
        Model of the machine and the filter.
    reading_noise : float
        Standard deviation of a displacement reading, m.
    thresholds : Thresholds
        Thresholds of faults, jumps and the calibrated range.
    """

    model: ObserverModel
    reading_noise: float = READING_NOISE
    thresholds: Thresholds = USUAL
    schema: str = SCHEMA

    def _facts(self) -> dict[str, str]:
        return facts_of(self)

    @property
    def kind(self) -> Kind:
        """Name of the kind."""
        return self.model.kind

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        return self.model.axes

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Sensors and the ambient, relative to the ambient of the cold machine, K.

        Then factors of the loads that change, the positions of moving axes, m, their odometers, m,
        and powers of sources, W. Displacement readings come last, m; a sample may end before them.
        """
        return self.precomputed.channels

    @property
    def details(self) -> tuple[Channel, ...]:
        """Heat of every source, the ambient, and the lowest and highest pressure in the joints.

        With moving axes also, for each displacement whose line a control is given: that line, and
        the displacement at the present position and at the positions asked for. With several, the
        lines of every displacement along each of them too, the others at their present positions.
        """
        return estimate_details(self.model)

    @cached_property
    def observer(self) -> Observer:
        """The recursion from sample to sample, with the noise of the displacement readings."""
        probe = replace(self.thresholds.probe, noise=self.reading_noise)
        return Observer(self.model, replace(self.thresholds, probe=probe))

    @cached_property
    def precomputed(self) -> Precomputed:
        """Its data for all samples."""
        return Precomputed(self.observer)

    @property
    def parts(self) -> Layout:
        """Slices of the parts of the state."""
        return self.precomputed.layout

    def zero_of(self, temperatures: Array, ambient: float) -> float:
        """Return an ambient if it can be that of the cold machine, else NaN.

        Relative to a faulty reading of the ambient, most sensors have impossible values.

        Parameters
        ----------
        temperatures : ndarray, shape (p,)
            Of the sensors, NaN where missing.
        ambient : float
            Relative to the same zero, K.
        """
        return cold_ambient(self.precomputed, temperatures, ambient)

    def initial_state(self) -> Array:
        """Return the state of a machine at rest, before any sample."""
        return initial_states.at_rest(self.observer).flat()

    def warm_state(self) -> Array:
        """Return the state of a machine with an unknown past, before any sample."""
        return initial_states.unknown_past(self.observer).flat()

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`.

        Parameters
        ----------
        state : ndarray
            After the previous sample; it is not modified.
        time : float
            s, later than that of the previous sample.
        values : sequence of float
            As `channels`; NaN where a reading is missing.

        Raises
        ------
        InputError
            Time does not increase, or the number of values is wrong.
        ConvergenceError
            No equilibrium of the joint is found at these temperatures.
        """
        data = self.precomputed
        read = split_sample(data, values)
        after, processed = process(data, state, time, read)
        return after, estimate_of(data, processed, time, read)

    def displacements(self, samples: Array) -> Array:
        """Return the displacements in a run from rest without their bands, (n, axes), m.

        They equal those of `estimator.interface.follow` at the present position (`lines.here`).

        Parameters
        ----------
        samples : ndarray, shape (n, 1 + channels)
            Times, s, and the values of the channels.

        Raises
        ------
        InputError, ConvergenceError
            As `sample`.
        """
        return whole_runs.displacements_of(self.precomputed, self.results(samples))

    def results(self, samples: Array) -> Results:
        """Return the results of a run from rest without displacement readings.

        Parameters
        ----------
        samples : ndarray, shape (n, 1 + channels)
            Times, s, and the values of the channels.

        Raises
        ------
        InputError, ConvergenceError
            As `sample`.
        """
        return whole_runs.results_in(self.precomputed, samples, self.initial_state())

    def whole_run(self, samples: Array, state: Array) -> tuple[Array, Array]:
        """Return displacements and half-widths of their bands in a run, (n, axes), m.

        They equal those of `estimator.interface.follow` up to rounding; ordinary samples are
        processed many at a time.

        Parameters
        ----------
        samples : ndarray, shape (n, 1 + channels)
            Times, s, and the values of the channels.
        state : ndarray
            Before the first of them.

        Raises
        ------
        InputError, ConvergenceError
            As `sample`.
        """
        return whole_runs.banded(self.precomputed, samples, state)
