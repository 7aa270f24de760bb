"""The array types of the numerical code, and functions of position on them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Position (3, n), m, to values (n,).
OfPosition = Callable[[Array], Array]
