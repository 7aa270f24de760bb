"""Data that an observer needs in every sample and that is computed once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimator import sensor_faults
from estimator.interface import Channel
from estimator.joint_aware import (
    compiled_sample,
    displacement_readings,
    fault_isolation,
    initial_states,
    innovation_gate,
    power_readings,
    unreported_motion,
)
from estimator.joint_aware.channels import sample_channels
from estimator.joint_aware.dropouts import Dropouts
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_state import Layout
from fesim.march.kernel import owned
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.physics import heat_step


@dataclass(frozen=True, eq=False)
class Precomputed:
    """Data of an observer for all its samples, each computed when it is first needed."""

    #: Observer of the machine.
    observer: Observer

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Contents of a sample."""
        return sample_channels(self.observer.model)

    @cached_property
    def ends(self) -> tuple[int, int, int, int]:
        """Numbers of values of a sample up to its temperatures, factors, odometers and powers."""
        model, thermal = self.observer.model, len(self.observer.system.rows)
        stood = thermal + len(model.loads) + len(model.positions)
        counted = stood + len(model.ways)
        return thermal, stood, counted, counted + len(model.powers)

    @cached_property
    def strokes(self) -> tuple[Array, Array]:
        """Ends of the strokes of the axes, (x,) each, m; without axes, of none."""
        way = self.observer.model.modes.way
        ends = [] if way is None else [one[[0, -1]] for one in way.stations.positions]
        low, high = np.reshape(ends, (len(ends), 2)).T
        return low, high

    @cached_property
    def layout(self) -> Layout:
        """Slices of the parts of the state."""
        return initial_states.at_rest(self.observer).layout

    @cached_property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of displacements, relaxations and mean innovations of a sample."""
        model, system = self.observer.model, self.observer.system
        relaxations = system.decay.size - model.modes.rates.size
        return len(model.axes), relaxations, 3 * len(system.rows)

    @cached_property
    def forgetting(self) -> Array:
        """Decay rates of displacement readings (`displacement_readings.forgetting`), 1/s."""
        band, probe = self.observer.model.band, self.observer.thresholds.probe
        return displacement_readings.forgetting(band, probe)

    @cached_property
    def calibrated_readings(self) -> tuple[Array, Array]:
        """Calibrated range of every channel, K."""
        return innovation_gate.calibrated_readings(self.observer)

    @cached_property
    def readable(self) -> sensor_faults.Channels:
        """Properties of the temperature readings."""
        return innovation_gate.gated_channels(self.observer, self.calibrated_readings)

    @cached_property
    def most_power(self) -> Array:
        """Largest plausible power, of either sign, W, shape (t,)."""
        return power_readings.most_power(self.observer)

    @cached_property
    def unreported_motion(self) -> Dropouts | None:
        """Uncertainty due to unreported motion, m; None without axes or known speeds."""
        model = self.observer.model
        known = model.moving_axes and model.calibrated.speeds
        return unreported_motion.unreported_motion(self.observer) if known else None

    @cached_property
    def place(self) -> compiled_sample.Place | None:
        """Data for ordinary samples in compiled code; None where it does not apply."""
        model, observer = self.observer.model, self.observer
        kernel = observer.physics.kernel
        if kernel is None:
            return None
        relaxing = 1.0 / (1.0 + model.step * model.discrepancy.rates)
        own = compiled_sample.Filter(
            relaxing=np.tile(relaxing, (model.power.size, 1)),
            power=model.power,
            rows=np.ascontiguousarray(observer.system.rows),
            gain=np.ascontiguousarray(observer.steady_gain),
            discrepancy=np.ascontiguousarray(model.discrepancy.displacement),
            channels=self.readable,
            rules=observer.thresholds.faults,
            possible=_possible(observer),
            forgetting=self.forgetting,
        )
        return compiled_sample.place_of(own, heat_step(model.modes, model.step), kernel)


def _possible(observer: Observer) -> compiled_sample.Possible:
    """Data to explain innovations by changes of heat since the last step."""
    onset, most, slack = innovation_gate.possible_heat(observer, 1)
    covariance = observer.innovation_covariance(observer.known_start)
    found = fault_isolation.explaining_heat(onset, covariance)
    return compiled_sample.Possible(*map(owned, (onset, found, most, slack, covariance)))
