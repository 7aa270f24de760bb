"""Look at a finished batch: the table with pandas, all responses with xarray.

Run: python look.py FOLDER
"""

import sys
from pathlib import Path

import pandas as pd
import xarray as xr


def displacement_per_heat(folder: Path) -> pd.DataFrame:
    """Mean and spread of the displacement at the end per unit of heat input, um, by friction."""
    table = pd.read_parquet(folder / "summary.parquet")
    table = table[table["status"] == "done"]
    axes = [f"displacement_{axis}_final_um" for axis in "xy"]
    each = table[axes].div(table["heat_input.level"], axis=0)
    return each.groupby(table["joints.knee.friction_coefficient"]).agg(["mean", "std"])


def pressure_lost(folder: Path) -> xr.DataArray:
    """Largest loss of contact pressure in time, MPa, of every case, by its heat input."""
    data = xr.open_dataset(folder / "dataset.zarr", engine="zarr")
    lost = (data["pressure"].isel(time=0) - data["pressure"]).max("contact")
    return (1e-6 * lost.max("time")).sortby("heat_input.level")


if __name__ == "__main__":
    results = Path(sys.argv[1])
    print(displacement_per_heat(results).round(2).to_string())
    lost = pressure_lost(results)
    for level, value in zip(lost["heat_input.level"].to_numpy(), lost.to_numpy(), strict=True):
        print(f"heat input {level:.2f}: {value:.2f} MPa")
