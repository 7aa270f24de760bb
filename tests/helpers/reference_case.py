"""The equal-heights case as text, and coarse and short variants of it."""

import re
from importlib.resources import files

CASE = files("thermojoint").joinpath("cases/equal_heights.toml").read_text("utf-8")
COARSE = re.sub(r"joint_element_size_mm.*", "", CASE).replace(
    "element_size_mm = 50.0", "element_size_mm = 100.0"
)


def lasting(minutes):
    """The coarse case, with another duration."""
    return COARSE.replace("duration_min = 35.0", f"duration_min = {minutes}")
