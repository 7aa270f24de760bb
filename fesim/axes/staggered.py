"""Staggered march of a machine on axes: compiled if possible, else by plain steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from fesim.axes.axis import Axis
from fesim.axes.machine import MovingMachine
from fesim.axes.march import march_moving
from fesim.march.machine import State
from fesim.march.stepping import plainly_staggered
from fesim.march.track import Track
from thermojoint.artefacts.arrays import Array

#: Number of steps per call, at most and after a plain one; their aligned positions share an array.
BLOCK, FEW = 64, 4


def march_staggered(
    moving: MovingMachine, axes: Sequence[Axis], inputs: Array, start: State
) -> Iterator[Track]:
    """Yield the steps of a staggered march, one or more at a time.

    Parameters
    ----------
    moving, axes, inputs, start
        As for `fesim.axes.march.march_moving`, which has the same steps.

    Raises
    ------
    ConvergenceError, InputError
        As `march_moving`.
    """
    # Imported here because it loads a compiler, as in `fesim.march.contact.gap_solver`.
    from fesim.axes.kernel import axes_march

    compiled, state, done, block = axes_march(moving, axes), start, 0, BLOCK
    while done < len(inputs):
        rows, track = inputs[done : done + block], None
        block = min(2 * block, BLOCK)
        if compiled is not None and not state.parts:
            track = compiled.take(state, rows)
        if track is None:
            (track,), block = march_moving(moving, axes, rows[:1], plainly_staggered, state), FEW
        done, state = done + len(track), track.step(-1).state
        yield track
