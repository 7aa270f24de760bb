"""A kind of estimator as somebody else would add one: a rod that follows one thermometer."""

import json
import math
from dataclasses import dataclass

import numpy as np

from estimator.interface import Channel, Estimate, Status
from estimator.kind import Kind
from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class LaggingRod:
    """δ = gain · θ, θ a relaxation of the temperature; its state is (time, θ)."""

    gain: float
    tau: float
    schema: str = "lagging-rod"
    kind: str = "lagging-rod"
    axes: tuple[str, ...] = ("z",)
    channels: tuple[Channel, ...] = (Channel("T1", "K"),)
    details: tuple[Channel, ...] = (Channel("lag", "K"),)

    @property
    def model(self):
        return self

    def initial_state(self):
        return np.array([np.nan, 0.0])

    def sample(self, state, time, values):
        if not time > state[0] and not math.isnan(state[0]):
            raise InputError(f"time {time:g} s does not increase; drop the sample")
        (read,) = values
        missing = math.isnan(read)
        interval = 0.0 if math.isnan(state[0]) else time - state[0]
        target = state[1] if missing else read
        theta = target + (state[1] - target) * math.exp(-interval / self.tau)
        estimate = Estimate(
            time,
            np.array([self.gain * theta]),
            np.array([1e-6]),
            Status.READING_MISSING if missing else Status.OK,
            np.array([target - theta]),
            ("T1",) if missing else (),
        )
        return np.array([time, theta]), estimate


def read(path):
    """A rod from its file."""
    content = json.loads(path.read_text("utf-8"))
    return LaggingRod(1e-6 * content["gain_um_K"], content["tau_s"])


KIND = Kind("a lagging rod", read, fingerprint=lambda rod: f"{rod.gain!r} {rod.tau!r}")
