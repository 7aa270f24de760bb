"""Units of mesh files, and sizes that suggest a wrong one."""

from __future__ import annotations

#: Length of one unit of a mesh file's coordinates, m.
UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
#: Usual range of the size of a machine, m; outside it, the mesh may use another unit.
USUAL_SIZE = (0.02, 20.0)
