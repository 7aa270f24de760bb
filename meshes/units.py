"""Units of mesh files, and the sizes that reveal a wrong one."""

from __future__ import annotations

#: Length of one unit of a mesh file's coordinates, m.
UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
#: A machine is between these sizes, m; a mesh outside of them has perhaps another unit.
USUAL_SIZE = (0.02, 20.0)
