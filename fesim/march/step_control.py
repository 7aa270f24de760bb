"""Step lengths from estimated errors: a PI controller (Gustafsson 1991) on a ladder of lengths.

The error allowed in a step is in proportion to its length (error per unit step), whatever the end
of the march: a march that is continued goes on as if it had never stopped. Functions of
numbers alone are compiled as well, by `fesim.march.compiled_adaptive`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Longest step, s, and the steps of a ladder down from it, so that few weights have to be made.
LONGEST = 3600.0
OCTAVE, RUNGS = 4, 120
SHORTEST = LONGEST * 2.0 ** (-RUNGS / OCTAVE)
#: The first step, s. Shorter ones follow what jumps, as a held temperature at a joint: they soon
#: grow with the time since, and each may use as much of the tolerance as one of this length.
BRIEF = LONGEST * 2.0**-16
#: Errors of steps have either sign and decay: their magnitudes may add up to so many tolerances in
#: so long a time, s.
TOGETHER, SPAN = 2.0, 1800.0
#: Times that differ by less than this part are the same.
ROUNDING = 1e-12
#: A step is wanted in which the error is this part of what is allowed, to the power of a length.
SAFETY = 0.9
#: Limits of the change of length from one step to the next.
LEAST, MOST = 0.2, 5.0
#: Powers of the error that the next length follows: the error is of second order over the length,
#: of third order alone (below `BRIEF`). Gain on the last error, of that on this one.
ROOT, SHORT_ROOT, LAST = 1.0 / 2.0, 1.0 / 3.0, 0.2
#: Part of a change that is followed; what rounding makes of a temperature, K.
FOLLOWED, ROUNDED = 1e-3, 1e-8
#: Errors below this part of what is allowed do not differ.
SMALL = 1e-4
#: Part of its length that a step is cut to if its equations have no solution.
RETREAT = 0.25
#: Between two knots nearer than `BRIEF`, steps are as if the edge lasted so long, s: friction
#: depends on the way of a load, not on its time. Times as near as the last are the same: a part of
#: the span between them could be lost in rounding.
EDGE, NEAREST = 1.0, 1e-7


@dataclass(frozen=True)
class Tolerance:
    """Error allowed in half an hour (`SPAN`)."""

    #: m.
    displacement: float
    #: Of the joints, K.
    temperature: float
    #: It says nothing of changes below it: until the machine's temperature has changed by as much,
    #: those of the joints may be off by this part of the change in a step.
    followed: float = FOLLOWED


@dataclass(frozen=True)
class StepError:
    """Estimated errors of one step, or of several together."""

    #: Shape (axes,): m.
    displacement: Array
    #: Shape (2 m,): of means and jumps at the contact elements, K.
    temperature: Array

    def __add__(self, other: StepError) -> StepError:
        """Return the errors of both together."""
        moved = self.displacement + other.displacement
        return StepError(moved, self.temperature + other.temperature)

    def largest(self) -> tuple[float, float]:
        """Return the largest magnitudes of both, m and K."""
        moved, warmed = np.abs(self.displacement), np.abs(self.temperature)
        return float(moved.max(initial=0.0)), float(warmed.max(initial=0.0))

    def relative_to(self, tolerance: Tolerance) -> float:
        """Return the larger of both, of what is allowed in half an hour."""
        moved, warmed = self.largest()
        return max(moved / tolerance.displacement, warmed / tolerance.temperature)


@dataclass(frozen=True)
class Pace:
    """The controller between two steps."""

    #: Of the next step, s.
    length: float = BRIEF
    #: Of the last step, of what was allowed in it.
    error: float = 1.0
    #: Changes of temperature in all steps so far, K.
    way: float = 0.0


def allowed(length: float) -> float:
    """Return the part of the tolerance that a step of a length (s) may use."""
    return TOGETHER * max(length, BRIEF) / SPAN


def stretch(apart: float) -> float:
    """Return how many times lengths count between two knots so far apart (s)."""
    return EDGE / apart if NEAREST < apart < BRIEF else 1.0


def least(times: float) -> float:
    """Return the shortest step (s) where lengths count so many `times`."""
    return BRIEF / times if times > 1.0 else SHORTEST


def bent_over(length: float, last: float, begins: bool) -> float:
    """Return the time (s) in which the flows of two steps bend.

    Parameters
    ----------
    length, last : float
        Of the step and of the one before, s; zero if that tells nothing.
    begins : bool
        Whether what drives the machine may bend between them: then the bend is in this step.
    """
    if last == 0.0 or (begins and last > length):
        return 2.0 * length
    return length + last


def of_allowed(part: float, share: float, warmed: float, followed: float) -> float:
    """Return the error of a step, of what is allowed in it.

    Parameters
    ----------
    part, share : float
        Error, and what is allowed in a step of this length (`allowed`), of the tolerance.
    warmed, followed : float
        Error of the joints' temperatures, and what may be of the change in the step, K.
    """
    return max(part / share, warmed / (followed + ROUNDED))


def next_pace(pace: Pace, taken: float, error: float, changed: float) -> Pace:
    """Return the pace after an accepted step.

    Parameters
    ----------
    pace : Pace
        Before it.
    taken : float
        Length of the step, s; shorter than that of the pace where a knot cut it.
    error : float
        Of the step, of what was allowed in it.
    changed : float
        Of temperature in the step, K.
    """
    error, way = max(error, SMALL), pace.way + changed
    return Pace(rung(next_length(pace.length, pace.error, taken, error)), error, way)


def shorter(pace: Pace, taken: float, error: float) -> Pace:
    """Return the pace after a rejected step; arguments as for `next_pace`."""
    return replace(pace, length=below(taken, rung(shorter_length(taken, error))))


def next_length(planned: float, last: float, taken: float, error: float) -> float:
    """Return the length wanted after a step of length `taken` (s) instead of `planned` (s).

    `error` and `last` are the errors of this step and of the one before, of what was allowed.
    """
    factor = SAFETY * (last**LAST / error) ** (SHORT_ROOT if taken < BRIEF else ROOT)
    length = taken * min(max(factor, LEAST), MOST)
    return max(length, planned) if taken < planned else length


def shorter_length(taken: float, error: float) -> float:
    """Return the length wanted after a step of length `taken` (s) that is rejected."""
    root = SHORT_ROOT if taken < BRIEF else ROOT
    return taken * min(max(SAFETY * error**-root, LEAST), 2.0**-0.5)


def retreated(pace: Pace, taken: float) -> Pace:
    """Return the pace after a step of length `taken` (s) whose equations have no solution."""
    return replace(pace, length=below(taken, rung(RETREAT * taken)))


def below(taken: float, wanted: float) -> float:
    """Return a wanted length of the ladder, or half of `taken` where the ladder has none below."""
    return 0.5 * taken if taken <= SHORTEST else wanted


def rung(length: float) -> float:
    """Return the longest length of the ladder that is not above `length` (s)."""
    below = math.ceil(OCTAVE * math.log2(LONGEST / length) - 1e-9)
    return LONGEST * 2.0 ** (-min(max(below, 0), RUNGS) / OCTAVE)


def until(length: float, left: float) -> float:
    """Return a step of `length` (s) or less that ends at a knot in `left` (s), or well before."""
    if length >= left:
        return left
    return length if 2.0 * length <= left else 0.5 * left
