"""Marches of one machine at the same time: each owns what it keeps from step to step."""

import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import numpy as np
import pytest
from reduced_bars import bars_of, modes_of, on_modes, warmed

from fesim.march.settling import initial_state
from fesim.march.stepping import march_along, staggered
from fesim.march.track import joined

HEATS = [warmed(2, watts=scale * np.array([0.0, 900.0, 0.0, 0.0])) for scale in (1, -2)]


@pytest.fixture(scope="module")
def machines():
    """A machine for two marches, and one for each of them alone."""
    bars = bars_of()
    modes = modes_of(bars)
    return [on_modes(bars, modes) for _ in range(3)]


def marched(machine, inputs):
    return joined(list(march_along(machine, inputs, staggered, initial_state(machine))))


def within_each_other(machine, calls):
    """Two marches in two threads: the second one runs after so many function calls of the first."""
    now, through, left = Event(), Event(), iter(range(calls))

    def first():
        def look(*_):
            if next(left, None) is None and not now.is_set():
                now.set()
                through.wait(60.0)

        sys.setprofile(look)
        try:
            return marched(machine, HEATS[0])
        finally:
            sys.setprofile(None)
            now.set()

    def second():
        now.wait(60.0)
        try:
            return marched(machine, HEATS[1])
        finally:
            through.set()

    with ThreadPoolExecutor(2) as threads:
        return [found.result() for found in (threads.submit(first), threads.submit(second))]


def test_two_threads_that_march_one_machine_do_not_touch_each_other(machines):
    alone = [marched(one, inputs) for one, inputs in zip(machines, HEATS, strict=False)]
    for calls in range(0, 400, 4):
        for own, expected in zip(within_each_other(machines[2], calls), alone, strict=True):
            for name in ("displacement", "gap", "pressure", "frozen", "heat_flow"):
                np.testing.assert_array_equal(getattr(own, name), getattr(expected, name))
