"""Meshing of CAD files with names by Gmsh (the extra ``gmsh``): STEP, IGES or BREP to MSH.

Solids keep their names and become bodies, unless others are given. Faces shared by two solids
become the two sides of a joint, ``BODY1_BODY2.a`` and ``.b``; a face that is only partly covered is
divided there, so that its rest still convects. The solids are meshed separately: they share no
node. Faces are identified by points on them; unnamed ones are collected as ``BODY_outer``.
"""

from __future__ import annotations

import math
import re
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import combinations, product
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.files import whole_file
from thermojoint.artefacts.settings.read import read_settings
from thermojoint.artefacts.settings.section import Point, Section

SUFFIXES = (".step", ".stp", ".iges", ".igs", ".brep")
#: Largest number of cells of a part: beyond it Gmsh or the simulator would take more than a day.
MOST_CELLS = 2e7
#: Largest distance of a face from the point that identifies it, relative to the size of the part.
NEAR = 1e-4
#: Faces whose distances from a point differ by less, relative to the size of the part, are one.
AS_NEAR = 1e-9
#: Faces that share less than this fraction of the smaller one touch only at an edge.
LEAST_OVERLAP = 1e-3

DimTag = tuple[int, int]


class NamesFile(Section):
    """A file of names.

    ``[surfaces_mm]`` with NAME = [[x, y, z], ...], points on its faces; ``[bodies_mm]`` with
    NAME = [x, y, z], a point on its surface; ``[joints]`` with NAME = [BODY, BODY].
    """

    surfaces_mm: dict[str, Annotated[list[Point], Field(min_length=1)]] = {}
    bodies_mm: dict[str, Point] = {}
    joints: dict[str, Annotated[tuple[str, str], Field(strict=False)]] = {}


class Names(NamedTuple):
    """Names given to the parts of a CAD file."""

    #: From name to points on its faces, m.
    surfaces: Mapping[str, Sequence[Point]] = MappingProxyType({})
    #: From name to a point on its surface, m.
    bodies: Mapping[str, Point] = MappingProxyType({})
    #: From name to its two bodies, that of side ``.a`` first.
    joints: Mapping[str, tuple[str, str]] = MappingProxyType({})


NO_NAMES = Names()


def read_names(path: Path) -> Names:
    """Read the names of faces, bodies and joints; points in m.

    Raises
    ------
    InputError
        The file is missing, not TOML, or has other contents.
    """
    given = read_settings(NamesFile, path, "names")
    return Names(
        {name: [_in_m(point) for point in points] for name, points in given.surfaces_mm.items()},
        {name: _in_m(point) for name, point in given.bodies_mm.items()},
        given.joints,
    )


def _in_m(point: Point) -> Point:
    x, y, z = point
    return 1e-3 * x, 1e-3 * y, 1e-3 * z


def mesh_cad(
    part: Path,
    out: Path,
    size: float,
    order: int = 1,
    names: Names = NO_NAMES,
) -> None:
    """Mesh a CAD file with tetrahedra and write it with its names, coordinates in m.

    Parameters
    ----------
    part : Path
        One of `SUFFIXES`; its own unit of length is respected.
    out : Path
        ``.msh``, written whole or not at all.
    size : float
        Largest element edge, m.
    order : int
        1, or 2 for curved cells.
    names : Names
        Names of faces, bodies and joints.

    Raises
    ------
    InputError
        Gmsh is not installed, the file is unreadable or has no solid, a point lies on no face, a
        joint's bodies do not touch, or Gmsh fails.
    """
    if out.suffix != ".msh":
        raise InputError(f"{out}: the mesh is written as MSH; name it {out.stem}.msh")
    with _opened(part, names) as (gmsh, bodies, sides):
        with _in_one_line(part, "find its faces", "correct solids that overlap"):
            surfaces = _surfaces(gmsh, bodies, sides, names.surfaces)
        with _in_one_line(part, "mesh it", "take another element size or correct the part"):
            for name, volume in bodies.items():
                _group(gmsh, 3, [volume], name)
            for name, faces in surfaces.items():
                _group(gmsh, 2, faces, name)
            _check_size(gmsh, part, size)
            gmsh.option.setNumber("Mesh.MeshSizeMax", size)
            gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 12)
            gmsh.model.mesh.generate(3)
            gmsh.model.mesh.setOrder(order)
            if order > 1:
                gmsh.model.mesh.optimize("HighOrderElastic")
            with whole_file(out) as unfinished:
                gmsh.write(str(unfinished))


class Face(NamedTuple):
    """A face that belongs to no joint."""

    body: str
    #: Point on it, away from its edges, m.
    point: Point
    #: Area, m2.
    area: float


def free_faces(part: Path, size: float) -> tuple[list[Face], list[tuple[str, str]]]:
    """Return the faces of a CAD file that belong to no joint, and the bodies of every joint.

    Parameters
    ----------
    part : Path
        One of `SUFFIXES`.
    size : float
        Largest edge of the triangles that determine the points, m.

    Raises
    ------
    InputError
        As `mesh_cad`.
    """
    with _opened(part, NO_NAMES) as (gmsh, bodies, sides):
        taken = {tag for tags in sides.values() for tag in tags}
        with _in_one_line(part, "find its faces", "take another element size or correct the part"):
            _check_size(gmsh, part, size)
            gmsh.option.setNumber("Mesh.MeshSizeMax", size)
            gmsh.model.mesh.generate(2)
            faces = [
                Face(body, _point_on(gmsh, tag), gmsh.model.occ.getMass(2, tag))
                for body, volume in bodies.items()
                for tag in _faces(gmsh, volume)
                if tag not in taken
            ]
        touching = [pair for pair in combinations(bodies, 2) if f"{'_'.join(pair)}.a" in sides]
        return faces, touching


def _point_on(gmsh: Any, tag: int) -> Point:  # noqa: ANN401
    """Return the point of a face below the triangle nearest to its middle."""
    nodes, at, _ = gmsh.model.mesh.getNodes(2, tag, includeBoundary=True)
    places = dict(zip(nodes.tolist(), at.reshape(-1, 3), strict=True))
    (corners,) = gmsh.model.mesh.getElements(2, tag)[2]
    middles = np.array([places[node] for node in corners.tolist()]).reshape(-1, 3, 3).mean(axis=1)
    nearest = middles[np.linalg.norm(middles - middles.mean(axis=0), axis=1).argmin()]
    x, y, z = gmsh.model.getClosestPoint(2, tag, nearest)[0]
    return float(x), float(y), float(z)


@contextmanager
def _opened(part: Path, names: Names) -> Iterator[tuple[Any, dict[str, int], dict[str, list[int]]]]:
    """Open a part in Gmsh; provide its bodies, and the faces of each side of its joints."""
    if part.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{part}: unknown suffix {part.suffix!r}; give one of {', '.join(SUFFIXES)}"
        )
    if not part.is_file():
        raise InputError(f"{part}: no such CAD file; check its name")
    with _gmsh_session() as gmsh:
        with _in_one_line(part, "read it", "export it again"):
            gmsh.model.occ.importShapes(str(part))
            gmsh.model.occ.synchronize()
        with _in_one_line(part, "find its joints", "correct solids that overlap"):
            bodies = _bodies(gmsh, names.bodies)
            if not bodies:
                raise InputError(f"{part}: contains no solid; export solids, not surfaces")
            sides = _joint_sides(gmsh, bodies, names.joints)
        yield gmsh, bodies, sides


def _check_size(gmsh: Any, part: Path, size: float) -> None:  # noqa: ANN401
    """Refuse an element size that gives more cells than can be simulated.

    The estimate uses regular tetrahedra in the volume and regular triangles on the surface.
    """
    volume, area = (
        sum(gmsh.model.occ.getMass(*entity) for entity in gmsh.model.getEntities(dimension))
        for dimension in (3, 2)
    )
    by_volume, by_area = 6.0 * math.sqrt(2.0) * volume, 4.0 / math.sqrt(3.0) * area
    cells = max(by_volume / size**3, by_area / size**2)
    if cells > MOST_CELLS:
        least = max(math.cbrt(by_volume / MOST_CELLS), math.sqrt(by_area / MOST_CELLS))
        raise InputError(
            f"{part}: elements of {1e3 * size:g} mm would be some {cells:.0e}, of which "
            f"{MOST_CELLS:.0e} can be simulated; take {1.05e3 * least:.2g} mm or larger"
        )


@contextmanager
def _in_one_line(part: Path, task: str, remedy: str) -> Iterator[None]:
    try:
        yield
    except (InputError, OSError, MemoryError):
        raise
    # Gmsh does not raise anything more specific.
    except Exception as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{part}: Gmsh cannot {task} ({reason}); {remedy}") from error


@contextmanager
def _gmsh_session() -> Iterator[Any]:
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise InputError(
            f"Gmsh cannot be loaded ({error}); pip install -e '.[gmsh]', and its system "
            "libraries (Debian: libglu1-mesa libxcursor1 libxft2 libxinerama1)"
        ) from error
    with _broken_pipes_as_errors():
        gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Geometry.OCCImportLabels", 1)
        gmsh.option.setString("Geometry.OCCTargetUnit", "M")
        yield gmsh
    finally:
        gmsh.finalize()


@contextmanager
def _broken_pipes_as_errors() -> Iterator[None]:
    """Restore the process setting that Gmsh changes when it starts.

    It sets SIGPIPE to its default action: from then on, writing to a connection closed by its
    reader would kill the process silently, while Python raises `BrokenPipeError`.
    """
    before = signal.getsignal(signal.SIGPIPE) if hasattr(signal, "SIGPIPE") else None
    try:
        yield
    finally:
        # Handlers can be set in the main thread only; None is a handler not set from Python.
        if before is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGPIPE, before)


def _group(gmsh: Any, dimension: int, tags: Sequence[int], name: str) -> None:  # noqa: ANN401
    gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, tags), name)


def _plain(label: str) -> str:
    """Return the last part of a CAD label without characters that mesh files cannot represent."""
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", label.rsplit("/", 1)[-1]).strip("_.")


def _bodies(gmsh: Any, given: Mapping[str, Point]) -> dict[str, int]:  # noqa: ANN401
    """Names of the solids, given ones first; numbered if missing or not unique."""
    named = {}
    for name, point in given.items():
        solids, _ = gmsh.model.getAdjacencies(2, _faces_at(gmsh, name, point)[0])
        named[int(solids[0])] = name
    labels = {tag: _plain(gmsh.model.getEntityName(3, tag)) for _, tag in gmsh.model.getEntities(3)}
    all_names = list(labels.values())
    names = {
        tag: name if name and all_names.count(name) == 1 else f"{name or 'body'}_{tag}"
        for tag, name in labels.items()
    } | named
    if len(set(names.values())) < len(names):
        raise InputError(f"bodies {', '.join(names.values())}: two have the same name; rename one")
    return {name: tag for tag, name in names.items()}


def _faces(gmsh: Any, volume: int) -> list[int]:  # noqa: ANN401
    return [abs(tag) for _, tag in gmsh.model.getBoundary([(3, volume)], oriented=False)]


def _joint_sides(
    gmsh: Any,  # noqa: ANN401
    bodies: Mapping[str, int],
    given: Mapping[str, tuple[str, str]],
) -> dict[str, list[int]]:
    """Divide the solids' faces where they touch; return the faces of each joint side.

    The two sides are separate copies: a common one would join their meshes.
    """
    occ = gmsh.model.occ
    faces = {body: _faces(gmsh, volume) for body, volume in bodies.items()}
    patches: dict[str, dict[str, list[DimTag]]] = {body: {} for body in bodies}
    for name, second in combinations(given, 2):
        if set(given[name]) == set(given[second]):
            raise InputError(f"joints.{second}: the same bodies as joints.{name}; give one name")
    names = {pair: name for name, pair in given.items()}
    bodies_of: dict[str, tuple[str, str]] = {}
    for pair in combinations(bodies, 2):
        first, other = pair if pair in names else pair[::-1] if pair[::-1] in names else pair
        name = names.pop((first, other), f"{first}_{other}")
        shared = [
            patch for pair in product(faces[first], faces[other]) for patch in _shared(gmsh, *pair)
        ]
        if not shared and name in given:
            raise InputError(f"joints.{name}: {first} and {other} do not touch; remove it")
        if shared:
            if name in bodies_of:
                raise InputError(
                    f"joints.{name}: {' and '.join(bodies_of[name])} have a joint of that name, "
                    f"{first} and {other}, too; give one of them another in [joints]"
                )
            bodies_of[name] = first, other
            patches[first][f"{name}.a"] = shared
            patches[other][f"{name}.b"] = occ.copy(shared)
    if names:
        (first, other), name = next(iter(names.items()))
        wrong = other if first in bodies else first
        raise unknown_name("body", wrong, bodies, f"joints.{name}")
    sides_by_name = {}
    for body, sides in patches.items():
        tools = [patch for side in sides.values() for patch in side]
        if tools:
            _, (_, *pieces) = occ.fragment([(3, bodies[body])], tools)
            now = dict(zip(tools, pieces, strict=True))
            for name, side in sides.items():
                sides_by_name[name] = sorted({tag for patch in side for _, tag in now[patch]})
    occ.synchronize()
    return sides_by_name


def _surfaces(
    gmsh: Any,  # noqa: ANN401
    bodies: Mapping[str, int],
    sides: Mapping[str, list[int]],
    names: Mapping[str, Sequence[Point]],
) -> dict[str, list[int]]:
    """Faces of every surface.

    If the two sides of a joint are at a point, it refers to that of the body with the other points:
    a guide is the face below the slide and the rest of it.
    """
    body_of = {tag: body for body, volume in bodies.items() for tag in _faces(gmsh, volume)}
    for name in names:
        if name in bodies or name in sides:
            raise InputError(
                f"surfaces_mm.{name}: a body or a side of a joint has that name; take another"
            )
    surfaces = {}
    for name, points in names.items():
        found = [_faces_at(gmsh, name, point) for point in points]
        own = {body_of[tags[0]] for tags in found if len(tags) == 1}
        surfaces[name] = sorted(
            {next((tag for tag in tags if body_of[tag] in own), tags[0]) for tags in found}
        )
    surfaces |= sides
    taken = {tag for tags in surfaces.values() for tag in tags}
    for body, volume in bodies.items():
        rest = [tag for tag in _faces(gmsh, volume) if tag not in taken]
        if rest and f"{body}_outer" in surfaces:
            raise InputError(
                f"surfaces_mm.{body}_outer: faces of {body} without a name are gathered under that "
                "name; take another, or give points on all of them"
            )
        if rest:
            surfaces[f"{body}_outer"] = rest
    return surfaces


def _faces_at(gmsh: Any, name: str, point: Point) -> list[int]:  # noqa: ANN401
    """The nearest face to a point, and those at the same distance."""
    occ = gmsh.model.occ
    at = occ.addPoint(*point)
    box = gmsh.model.getBoundingBox(-1, -1)
    size = max(high - low for low, high in zip(box[:3], box[3:], strict=True))
    tags = [tag for _, tag in gmsh.model.getEntities(2)]
    near = [tag for tag in tags if _is_in_box(gmsh, tag, point, NEAR * size)]
    away = {tag: occ.getDistance(0, at, 2, tag)[0] for tag in near or tags}
    occ.remove([(0, at)])
    nearest = min(away, key=lambda tag: away[tag])
    if away[nearest] > NEAR * size:
        where = ", ".join(f"{1e3 * x:g}" for x in point)
        raise InputError(
            f"surface {name!r}: no face at ({where}) mm; the nearest is "
            f"{1e3 * away[nearest]:.3g} mm away"
        )
    return [tag for tag in away if away[tag] <= away[nearest] + AS_NEAR * size]


def _is_in_box(gmsh: Any, tag: int, point: Point, slack: float) -> bool:  # noqa: ANN401
    box = gmsh.model.getBoundingBox(2, tag)
    return all(box[k] - slack <= point[k] <= box[3 + k] + slack for k in range(3))


def _shared(gmsh: Any, face: int, other: int) -> list[DimTag]:  # noqa: ANN401
    """Return new faces: the part of face `face` that lies on face `other`."""
    boxes = [gmsh.model.getBoundingBox(2, tag) for tag in (face, other)]
    slack = NEAR * max(b[3 + k] - b[k] for b in boxes for k in range(3))
    if any(
        boxes[0][k] > boxes[1][3 + k] + slack or boxes[1][k] > boxes[0][3 + k] + slack
        for k in range(3)
    ):
        return []
    occ = gmsh.model.occ
    # Copies, since faces of the solids themselves would be bound to the result.
    copies = occ.copy([(2, face), (2, other)])
    common, _ = occ.intersect(copies[:1], copies[1:])
    shared = [patch for patch in common if patch[0] == 2]
    area = sum(occ.getMass(*patch) for patch in shared)
    if area > LEAST_OVERLAP * min(occ.getMass(2, tag) for tag in (face, other)):
        return shared
    occ.remove(common, recursive=True)
    return []
