"""The whole chain made short for the tests: a day of forty minutes, few machines for the bands.

Nor are fits searched from as many starts as a user's.
"""

from contextlib import contextmanager

import pytest

from calibrate import least_squares
from calibrate.joint_aware.calibration import Effort
from calibrate.joint_aware.open_band import Drawing
from calibrate.joint_aware.physics_fit import Search
from calibrate.placement.fchs import Rule
from thermojoint.paper.long_runs import LongRuns

#: One search, and bands from two drawn machines and a quarter of an hour.
QUICK = Effort(search=Search(starts=0), drawing=Drawing(draws=2, duration=900.0))
#: The placement of a and b, with fits to a fifth of the pairs.
FEW_PAIRS = Rule(shortlist=12)
SHORT = LongRuns(
    day=40.0,
    warm=20.0,
    settled=5.0,
    cool_down=20.0,
    heated=10.0,
    steady=40.0,
    effort=QUICK,
    rule=FEW_PAIRS,
    processes=1,
)


@contextmanager
def few_starts():
    """Meanwhile no fit begins from more than four places; `tests/calibrate` fits from all."""
    every = least_squares._starts
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            least_squares, "_starts", lambda problem, count: every(problem, min(count, 4))
        )
        yield
