"""Barber's bistable rod: 20 µm away from a hot wall when cold, with air between.

With its wall at 24 K the rod has three steady states. `thermojoint.verification.bistable` has the
rod and its balance in closed form; this writes the mesh of `case.toml` and prints the three states.

Run: ``python examples/bistable_rod/bistable_rod.py examples/bistable_rod/rod.vtu``
"""

import sys
from pathlib import Path

from meshes.exchange import write_structure
from thermojoint.verification.bistable import STATES, WALL, rod, steady_states

if __name__ == "__main__":
    write_structure(rod(), Path(sys.argv[1]))
    for name, (opening, pressure, end) in zip(STATES, steady_states(WALL), strict=True):
        print(
            f"{name}: end at {end:.2f} K, {1e-6 * pressure:.3g} MPa, moved {-1e6 * opening:.1f} um"
        )
