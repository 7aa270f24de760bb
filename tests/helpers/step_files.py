"""STEP files as a CAD system exports them: solids with names, in mm."""

import json
import re
import subprocess
import sys

import pytest

try:
    import gmsh
except (ImportError, OSError):
    gmsh = None
needs_gmsh = pytest.mark.skipif(gmsh is None, reason="Gmsh cannot be imported here")

# In a process of its own: Open CASCADE numbers the files of a process, and keeps the unit that the
# last import asked for.
_SCRIPT = """
import json, sys
import gmsh
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
for kind, *numbers in json.loads(sys.argv[2]):
    getattr(gmsh.model.occ, kind)(*numbers)
for volume, hole in json.loads(sys.argv[3]):
    gmsh.model.occ.cut([(3, volume)], [(3, hole)])
gmsh.model.occ.synchronize()
gmsh.write(sys.argv[1])
gmsh.finalize()
"""


def write_step(path, solids, holes=()):
    """Write solids, each (name, kind, numbers...) with a kind of ``gmsh.model.occ``.

    Holes are pairs of numbers of solids, from 1: what is cut, and what is cut off and left out.
    """
    shapes = json.dumps([solid[1:] for solid in solids])
    arguments = [sys.executable, "-c", _SCRIPT, str(path), shapes, json.dumps(holes)]
    subprocess.run(arguments, check=True, capture_output=True)
    text = path.read_text()
    cut_off = {hole for _, hole in holes}
    left = [solid for number, solid in enumerate(solids, start=1) if number not in cut_off]
    for number, (name, *_) in enumerate(left, start=1):
        text, found = re.subn(
            rf"(Open CASCADE STEP translator [\d.]+ 1)\.{number}'", f"{name}'", text
        )
        assert found
    path.write_text(text)
