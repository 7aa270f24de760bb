"""The heat step of contact elements that pass stations, against the whole system of equations."""

from types import SimpleNamespace

import numpy as np
import pytest

from fesim.axes.guideway import GuideStations
from fesim.axes.occupation import shares_of, weights_at
from fesim.case.history import History
from fesim.march.passing import Passing, Rows, pass_heat

POSITIONS = np.linspace(0.0, 1.0, 6), np.linspace(-0.2, 0.2, 3)
#: The first two contact elements ride on the first axis, one after the other, the third on the
#: second axis, the fourth on none.
PLACE = (
    np.array([[k, k + 1, -1, -1] for k in range(6)]),
    np.array([[-1, -1, 7 + k, -1] for k in range(3)]),
)
STATIONS = GuideStations(POSITIONS, PLACE)
COURSES = (
    History(np.array([0.0, 3.0, 10.0]), np.array([0.1, 0.75, 0.5])),
    History(np.array([0.0]), np.array([-0.05])),
)
LENGTH = 10.0
FLOWS, HEAT = np.array([3.0, 5.0, 2.0, 4.0]), np.array([0.3, 0.7, 0.0, 0.0])


@pytest.fixture(scope="module")
def shares():
    ways = zip(POSITIONS, COURSES, strict=True)
    return [shares_of(*way, 0.0, LENGTH) for way in ways]


@pytest.fixture(scope="module")
def coefficients():
    """b (t, m, m + n) at many times in the step."""
    times = LENGTH * (np.arange(4000) + 0.5) / 4000
    found = np.zeros((times.size, 4, STATIONS.size))
    for at, time in enumerate(times):
        weights = [
            weights_at(positions, float(course(time)))
            for positions, course in zip(POSITIONS, COURSES, strict=True)
        ]
        found[at] = STATIONS.coefficients(weights)
    return found


def test_heat_passes_to_every_station_for_its_share_of_the_time(shares, coefficients):
    rng = np.random.default_rng(7)
    count, modes = STATIONS.size, 25
    rows, inputs = rng.normal(size=(count, modes)), rng.normal(size=(modes, 2))
    rate = rng.uniform(1.0, 2.0, modes)
    diagonal = rate + rng.uniform(0.1, 9.0, modes)
    balance = SimpleNamespace(
        **dict.fromkeys(("after", "before"), np.zeros((0, modes))),
        flow=np.zeros((0, 4)),
        drive=np.zeros((0, 2)),
        entering=np.ones(2),
        stored=np.ones(modes),
        convected=np.ones(modes),
    )
    thermal = SimpleNamespace(
        factor=SimpleNamespace(solve=lambda right: right / diagonal),
        capacity_rate=np.diag(rate),
        inputs=inputs,
        balance=balance,
        step=LENGTH,
    )
    influence = rows / diagonal
    passing = Passing(
        Rows(rows, influence, influence @ rows.T),
        STATIONS.touches(shares),
        STATIONS.rubbed(HEAT, shares),
    )
    before, driven = rng.normal(size=modes), np.array([2.0, -1.0])
    taken = pass_heat(thermal, passing, before, driven, FLOWS)
    exchanged = np.einsum("e,tei,tej->ij", FLOWS, coefficients, coefficients) / len(coefficients)
    rubbed = 0.5 * HEAT @ np.abs(coefficients).mean(axis=0)
    right = rate * before + inputs @ driven + rubbed @ rows
    after = np.linalg.solve(np.diag(diagonal) + rows.T @ exchanged @ rows, right)
    assert np.allclose(taken.temperature, after, rtol=0.0, atol=1e-5 * np.abs(after).max())
    left = exchanged @ (rows @ after)
    assert np.allclose(taken.heat_flow, left[:4], rtol=0.0, atol=1e-5 * np.abs(left).max())
    # What passes nothing but its own joint stays out of it, and friction's heat is all there.
    assert passing.rubbed.sum() == pytest.approx(HEAT.sum())
