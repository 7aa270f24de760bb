"""The whole chain made short for the tests: a day of forty minutes, few machines for the bands."""

from contextlib import contextmanager

import pytest

from calibrate.joint_aware import open_band
from thermojoint.paper.long_runs import LongRuns

SHORT = LongRuns(day=40.0, warm=20.0, settled=5.0, cool_down=20.0, heated=10.0)


@contextmanager
def quick_bands():
    """Learn bands from two drawn machines and half an hour."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(open_band, "DRAWS", 2)
        patch.setattr(open_band, "DURATION", 1800.0)
        yield
