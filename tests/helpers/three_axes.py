"""The shipped machine with three axes on a coarse mesh."""

import tomllib
from importlib.resources import files
from pathlib import Path

from fesim.case.schema import case_from_data
from meshes.exchange import write_structure
from meshes.three_axes import three_axis_machine

PATH = Path(str(files("thermojoint").joinpath("cases/three_axes.toml")))


def coarse(folder, courses):
    """Elements and contact elements of 100 mm; courses are (s, mm) pairs of x, y and z."""
    data = tomllib.loads(PATH.read_text("utf-8"))
    write_structure(three_axis_machine(0.1), folder / "coarse.vtu")
    data["structure"]["file"] = "coarse.vtu"
    del data["volume"]
    for joint in data["joints"].values():
        joint |= {"along": 2, "across": 2}
    for name, axis in data["axes"].items():
        rows = "".join(f"{time:g},{place:g}\n" for time, place in courses[name])
        (folder / f"{name}.csv").write_text("time_s,position_mm\n" + rows)
        axis |= {"file": f"{name}.csv", "station_mm": 100.0}
    data["axes"]["x"].pop("rotation_within_mm")
    data["march"] |= {"step_s": 30.0, "duration_min": 20.0}
    return case_from_data(data, "three axes", folder)
