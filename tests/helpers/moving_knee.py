"""The shipped machine with a moving knee on a coarse mesh, and meshed where the knee stands."""

from importlib.resources import files
from pathlib import Path

from fesim.case.schema import case_from_data, read_case

PATH = Path(str(files("thermojoint").joinpath("cases/moving_knee.toml")))
#: A screw for its axis, and what it is made of.
STEEL = {
    "conductivity_W_mK": 45.0,
    "density_kg_m3": 7850.0,
    "heat_capacity_J_kgK": 470.0,
    "youngs_modulus_GPa": 206.0,
    "poisson_ratio": 0.3,
    "expansion_1_K": 11.5e-6,
}
SCREW = {
    "bearings": "fixed-free",
    "fixed_bearing_mm": -300.0,
    "far_end_mm": 260.0,
    "nut_length_mm": 100.0,
    "diameter_mm": 40.0,
    "lead_mm": 6.0,
    "material": "steel",
    "film_W_m2K": 10.0,
    "rotating_film": {"added_W_m2K": 15.0, "rotation_rpm": 200.0},
    "nut_torque_Nm": 30.0,
    "bearing_torque_Nm": 8.0,
    "motor_heat_W": 10.0,
    "cells": 40,
}


def coarse_data():
    """Data of the case: elements of 100 mm, four contact elements of 100 mm, steps of 30 s."""
    case = read_case(PATH).replace(
        structure={"element_size_mm": 100.0, "joint_element_size_mm": 50.0},
        joints={"knee": {"along": 4, "across": 1}},
        axes={"y": {"station_mm": 100.0}},
        march={"duration_min": 5.0, "step_s": 30.0},
    )
    return case.model_dump(mode="json", exclude_unset=True)


def coarse(**axis):
    """The case with changes of its axis; None removes a key."""
    data = coarse_data()
    data["axes"]["y"] = {
        key: value for key, value in (data["axes"]["y"] | axis).items() if value is not None
    }
    return case_from_data(data, "knee", Path())


def standing_at(position_mm, station_mm=100.0):
    """The knee on its axis at a position, without friction heat."""
    return coarse(
        file=None, position_mm=position_mm, station_mm=station_mm, rotation_within_mm=None
    )


def meshed_at(position_mm):
    """The same machine without an axis, meshed where the knee stands."""
    data = coarse_data()
    del data["axes"]
    for key in ("axis", "running_friction_coefficient"):
        del data["joints"]["knee"][key]
    dimensions = data["structure"]["dimensions_mm"]
    for name, height in {"table_bottom": 350.0, "table_top": 750.0, "screw_bottom": 250.0}.items():
        dimensions[name] = height + position_mm
    data["probes"]["table"]["position_mm"][1] += position_mm
    return case_from_data(data, "knee", Path())


def moving(folder, rows):
    """The knee along a history: (s, mm) pairs."""
    path = Path(folder) / "course.csv"
    path.write_text("time_s,position_mm\n" + "".join(f"{t:g},{p:g}\n" for t, p in rows))
    return coarse(file=str(path))
