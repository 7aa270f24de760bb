"""Step lengths from estimated errors: a PI controller (Gustafsson 1991) on a ladder of lengths.

The error allowed in a step is proportional to its length (error per unit step), independent of the
end of the march: a continued march proceeds as if it had never stopped. Functions of numbers only
are compiled as well, by `fesim.march.compiled_adaptive`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Longest step, s, and rungs of the ladder of shorter ones, which limits the sets of weights.
LONGEST = 3600.0
OCTAVE, RUNGS = 4, 120
SHORTEST = LONGEST * 2.0 ** (-RUNGS / OCTAVE)
#: The first step, s. Shorter ones follow jumps, such as a held temperature at a joint: they soon
#: grow with the time since, and each may use as much of the tolerance as one of this length.
BRIEF = LONGEST * 2.0**-16
#: Errors of steps have either sign and decay: their magnitudes may add up to this many tolerances
#: in this time, s.
TOGETHER, SPAN = 2.0, 1800.0
#: Times whose relative difference is below this are the same.
ROUNDING = 1e-12
#: Safety factor on the step length for which the error is the allowed one.
SAFETY = 0.9
#: Limits of the change of length from one step to the next.
LEAST, MOST = 0.2, 5.0
#: Exponents of the next length on the error, which is of second order over the length in a march,
#: of third order in a single step (below `BRIEF`); exponent on the last error relative to this one.
ROOT, SHORT_ROOT, LAST = 1.0 / 2.0, 1.0 / 3.0, 0.2
#: Allowed error of a temperature change, relative; rounding error of a temperature, K.
FOLLOWED, ROUNDED = 1e-3, 1e-8
#: Errors below this fraction of the allowed one are treated as equal.
SMALL = 1e-4
#: Fraction of its length to which a step is cut if its equations have no solution.
RETREAT = 0.25
#: Between two knots nearer than `BRIEF`, steps are scaled as if the edge took this long, s:
#: friction depends on the path of a load, not on its duration. Times nearer than the last value are
#: the same: a fraction of the span between them could be lost in rounding.
EDGE, NEAREST = 1.0, 1e-7


@dataclass(frozen=True)
class Tolerance:
    """Error allowed in half an hour (`SPAN`)."""

    #: Of displacements, m.
    displacement: float
    #: Of temperatures at the joints, K.
    temperature: float
    #: The tolerance does not limit changes below it: until the machine's temperature has changed by
    #: as much, the joint temperatures may be off by this fraction of the change in a step.
    followed: float = FOLLOWED


@dataclass(frozen=True)
class StepError:
    """Estimated errors of one step, or of several together."""

    #: Shape (axes,): of displacements, m.
    displacement: Array
    #: Shape (2 m,): of means and jumps at the contact elements, K.
    temperature: Array

    def __add__(self, other: StepError) -> StepError:
        """Return the sum of both."""
        moved = self.displacement + other.displacement
        return StepError(moved, self.temperature + other.temperature)

    def largest(self) -> tuple[float, float]:
        """Return the largest magnitudes of displacement and temperature, m and K."""
        moved, warmed = np.abs(self.displacement), np.abs(self.temperature)
        return float(moved.max(initial=0.0)), float(warmed.max(initial=0.0))

    def relative_to(self, tolerance: Tolerance) -> float:
        """Return the larger of both, relative to the tolerance for half an hour."""
        moved, warmed = self.largest()
        return max(moved / tolerance.displacement, warmed / tolerance.temperature)


@dataclass(frozen=True)
class Pace:
    """State of the controller between two steps."""

    #: Length of the next step, s.
    length: float = BRIEF
    #: Error of the last step, relative to the allowed one.
    error: float = 1.0
    #: Sum of the temperature changes of all steps so far, K.
    way: float = 0.0


def allowed(length: float) -> float:
    """Return the fraction of the tolerance that a step of a length (s) may use."""
    return TOGETHER * max(length, BRIEF) / SPAN


def stretch(apart: float) -> float:
    """Return the factor on lengths between two knots that are `apart` (s)."""
    return EDGE / apart if NEAREST < apart < BRIEF else 1.0


def least(times: float) -> float:
    """Return the shortest step (s) if lengths have the factor `times`."""
    return BRIEF / times if times > 1.0 else SHORTEST


def bent_over(length: float, last: float, begins: bool) -> float:
    """Return the time (s) over which the slope of the flows changes between two steps.

    Parameters
    ----------
    length, last : float
        Lengths of the step and of the one before, s; zero if its slope is not used.
    begins : bool
        Whether the slope of the inputs may change between them: then the change is in this step.
    """
    if last == 0.0 or (begins and last > length):
        return 2.0 * length
    return length + last


def of_allowed(part: float, share: float, warmed: float, followed: float) -> float:
    """Return the error of a step relative to the allowed one.

    Parameters
    ----------
    part, share : float
        Error, and the error allowed in a step of this length (`allowed`), of the tolerance.
    warmed, followed : float
        Error of the joint temperatures, and the one allowed for the change in the step, K.
    """
    return max(part / share, warmed / (followed + ROUNDED))


def next_pace(pace: Pace, taken: float, error: float, changed: float) -> Pace:
    """Return the pace after an accepted step.

    Parameters
    ----------
    pace : Pace
        Pace before the step.
    taken : float
        Length of the step, s; shorter than planned if a knot cut it.
    error : float
        Error of the step relative to the allowed one.
    changed : float
        Temperature change in the step, K.
    """
    error, way = max(error, SMALL), pace.way + changed
    return Pace(rung(next_length(pace.length, pace.error, taken, error)), error, way)


def shorter(pace: Pace, taken: float, error: float) -> Pace:
    """Return the pace after a rejected step; arguments as for `next_pace`."""
    return replace(pace, length=below(taken, rung(shorter_length(taken, error))))


def next_length(planned: float, last: float, taken: float, error: float) -> float:
    """Return the next length (s) after a step of length `taken` (s) instead of `planned` (s).

    `error` and `last` are the errors of this step and the one before, relative to the allowed ones.
    """
    factor = SAFETY * (last**LAST / error) ** (SHORT_ROOT if taken < BRIEF else ROOT)
    length = taken * min(max(factor, LEAST), MOST)
    return max(length, planned) if taken < planned else length


def shorter_length(taken: float, error: float) -> float:
    """Return the length (s) to try after a rejected step of length `taken` (s)."""
    root = SHORT_ROOT if taken < BRIEF else ROOT
    return taken * min(max(SAFETY * error**-root, LEAST), 2.0**-0.5)


def retreated(pace: Pace, taken: float) -> Pace:
    """Return the pace after a step of length `taken` (s) whose equations have no solution."""
    return replace(pace, length=below(taken, rung(RETREAT * taken)))


def below(taken: float, wanted: float) -> float:
    """Return the wanted length of the ladder, or half of `taken` if it has no shorter one."""
    return 0.5 * taken if taken <= SHORTEST else wanted


def rung(length: float) -> float:
    """Return the longest length of the ladder that does not exceed `length` (s)."""
    below = math.ceil(OCTAVE * math.log2(LONGEST / length) - 1e-9)
    return LONGEST * 2.0 ** (-min(max(below, 0), RUNGS) / OCTAVE)


def until(length: float, left: float) -> float:
    """Return a step of up to `length` (s) that ends at the knot in `left` (s) or well before."""
    if length >= left:
        return left
    return length if 2.0 * length <= left else 0.5 * left
