"""Methods of a sensitivity study, and their indices (docs/sensitivity.md)."""

from __future__ import annotations

from typing import Literal

Method = Literal["morris", "sobol"]
#: Method to the column for ranking, and the column of its uncertainty.
MEASURES = {
    "local": ("change", "error"),
    "morris": ("mu_star", "mu_star_conf"),
    "sobol": ("ST", "ST_conf"),
}
#: Method to the indices of a range.
INDICES: dict[Method, tuple[str, ...]] = {
    "morris": (*MEASURES["morris"], "mu", "sigma"),
    "sobol": (*MEASURES["sobol"], "S1", "S1_conf"),
}

#: A figure that changes by less (µm, K, MPa, or a fraction) counts as unchanged: its indices would
#: be those of rounding errors.
STILL = 1e-9
