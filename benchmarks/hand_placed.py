"""The machine of equal heights, bracket and source at any height, with four sensors set by hand."""

from __future__ import annotations

from benchmarks.study import case_data

#: Element sizes of the bodies and of the joint, mm: of the estimator's model, and of the plants.
MODEL, PLANT = (50.0, 25.0), (40.0, 20.0)
#: In mm: on the source, below it, and in the strips; not chosen by any error.
PLACES = {
    "s": (550.0, 650.0, 100.0),
    "b": (550.0, 450.0, 125.0),
    "T1": (625.0, 450.0, 87.5),
    "T2": (625.0, 700.0, 87.5),
}


def machine_data(height: float, sizes: tuple[float, float]) -> dict:
    """Return the equal-heights case on a mesh, bracket and source top at a height (mm)."""
    data = case_data("equal_heights")
    data["structure"] |= {"element_size_mm": sizes[0], "joint_element_size_mm": sizes[1]}
    data["structure"]["dimensions_mm"] = {
        "bracket_bottom": height,
        "bracket_top": height + 50.0,
        "source_top": height,
    }
    data["candidates"] = []
    data["probes"] = {
        name: {"position_mm": list(place), "body": "column"} for name, place in PLACES.items()
    }
    return data
