"""Mesh of a bolted pipe flange with Gmsh: a quarter of it, one bolt, tetrahedra that do not match.

Two flanges of cast iron are pressed together by four steel bolts. The quarter with the bolt at 45
degrees is meshed; x = 0 and y = 0 are symmetry planes. The bolt touches only with its head and its
nut, so that nothing but these two joints holds it.

Run: ``python examples/bolted_flange/flange.py examples/bolted_flange/flange.msh`` (needs Gmsh).
"""

import sys
from math import cos, pi, sin

import gmsh

BORE, RIM, THICKNESS = 0.030, 0.080, 0.020
CIRCLE, HOLE, SHANK, HEAD, HEAD_HEIGHT = 0.058, 0.0065, 0.006, 0.011, 0.008
#: Largest elements of each body, m.
SIZES = {"lower": 0.011, "upper": 0.009, "bolt": 0.0045}


def ring(low: float, high: float) -> int:
    """A quarter of a flange with its hole; return its volume."""
    occ = gmsh.model.occ
    x, y = CIRCLE * cos(pi / 4), CIRCLE * sin(pi / 4)
    disc = occ.addCylinder(0, 0, low, 0, 0, high - low, RIM, angle=pi / 2)
    bore = occ.addCylinder(0, 0, low, 0, 0, high - low, BORE, angle=pi / 2)
    hole = occ.addCylinder(x, y, low, 0, 0, high - low, HOLE)
    made, _ = occ.cut([(3, disc)], [(3, bore), (3, hole)])
    return made[0][1]


def bolt() -> int:
    """Shank, head and nut in one piece; return its volume."""
    occ = gmsh.model.occ
    x, y = CIRCLE * cos(pi / 4), CIRCLE * sin(pi / 4)
    shank = occ.addCylinder(x, y, -THICKNESS, 0, 0, 2 * THICKNESS, SHANK)
    head = occ.addCylinder(x, y, THICKNESS, 0, 0, HEAD_HEIGHT, HEAD)
    nut = occ.addCylinder(x, y, -THICKNESS - HEAD_HEIGHT, 0, 0, HEAD_HEIGHT, HEAD)
    made, _ = occ.fuse([(3, shank)], [(3, head), (3, nut)])
    return made[0][1]


def faces_of(volume: int) -> dict[int, tuple[float, ...]]:
    """Faces of a volume with their bounding boxes."""
    faces = gmsh.model.getBoundary([(3, volume)], oriented=False)
    return {tag: gmsh.model.getBoundingBox(2, tag) for _, tag in faces}


def flat_at(volume: int, axis: int, place: float) -> list[int]:
    """Faces of a volume in the plane x, y or z = place."""
    return [
        tag
        for tag, box in faces_of(volume).items()
        if max(abs(box[axis] - place), abs(box[3 + axis] - place)) < 1e-6
    ]


def main(out: str) -> None:
    """Build, name, mesh and write."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    volumes = {"lower": ring(-THICKNESS, 0.0), "upper": ring(0.0, THICKNESS), "bolt": bolt()}
    gmsh.model.occ.synchronize()
    lower, upper, screw = volumes.values()
    surfaces = {
        "faces.a": flat_at(lower, 2, 0.0),
        "faces.b": flat_at(upper, 2, 0.0),
        "head.a": flat_at(screw, 2, THICKNESS),
        "head.b": flat_at(upper, 2, THICKNESS),
        "nut.a": flat_at(screw, 2, -THICKNESS),
        "nut.b": flat_at(lower, 2, -THICKNESS),
        "symmetry_x": flat_at(lower, 0, 0.0) + flat_at(upper, 0, 0.0),
        "symmetry_y": flat_at(lower, 1, 0.0) + flat_at(upper, 1, 0.0),
        "base": flat_at(lower, 2, -THICKNESS),
        "bore": [
            tag
            for tag, box in faces_of(upper).items()
            if max(box[3], box[4]) < BORE + 1e-6 and box[5] - box[2] > 0.5 * THICKNESS
        ],
    }
    named = {tag for tags in surfaces.values() for tag in tags}
    every = [tag for volume in volumes.values() for tag in faces_of(volume)]
    # The face around the head convects, except the part that the joint covers.
    surfaces["outside"] = [tag for tag in every if tag not in named] + surfaces["head.b"]
    for dimension, groups in ((3, {n: [v] for n, v in volumes.items()}), (2, surfaces)):
        for name, tags in groups.items():
            group = gmsh.model.addPhysicalGroup(dimension, tags)
            gmsh.model.setPhysicalName(dimension, group, name)
    for name, volume in volumes.items():
        points = gmsh.model.getBoundary([(3, volume)], combined=False, recursive=True)
        gmsh.model.mesh.setSize(points, SIZES[name])
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 14)
    gmsh.option.setNumber("Mesh.Binary", 1)
    gmsh.model.mesh.generate(3)
    gmsh.write(out)
    gmsh.finalize()


if __name__ == "__main__":
    main(sys.argv[1])
