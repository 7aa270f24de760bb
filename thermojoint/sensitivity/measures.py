"""Methods of a sensitivity study, and the indices that each of them gives (docs/sensitivity.md)."""

from __future__ import annotations

from typing import Literal

Method = Literal["morris", "sobol"]
#: Method to the column that ranks, and the one that says how uncertain it is.
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
