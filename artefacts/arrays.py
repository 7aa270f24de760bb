"""The one array type of the numerical code, and functions of position on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Position (3, n), m, to values (n,).
OfPosition = Callable[[Array], Array]
