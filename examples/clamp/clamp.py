"""The clamp as a CAD system exports it: a block on a bed, solids with names, as STEP in mm.

Run: ``python examples/clamp/clamp.py examples/clamp/clamp.step`` (needs Gmsh).
"""

import re
import sys
from pathlib import Path

import gmsh

#: Name of a solid to its corner and its edges, mm.
SOLIDS = {
    "bed": (0.0, 0.0, 0.0, 150.0, 40.0, 20.0),
    "block": (50.0, 0.0, 20.0, 50.0, 40.0, 20.0),
}


def main(out: str) -> None:
    """Build, name and write."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    for box in SOLIDS.values():
        gmsh.model.occ.addBox(*box)
    gmsh.model.occ.synchronize()
    gmsh.write(out)
    gmsh.finalize()
    # Open CASCADE numbers the products of a file; a CAD system writes their names there.
    text = Path(out).read_text(encoding="utf-8")
    for number, name in enumerate(SOLIDS, start=1):
        text = re.sub(rf"Open CASCADE STEP translator [\d.]+ 1\.{number}'", f"{name}'", text)
    Path(out).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
