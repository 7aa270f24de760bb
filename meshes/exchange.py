"""Reading and writing of structures by meshio: VTU and Gmsh MSH, reading also other formats.

How names are stored:

- VTU, VTK: cell arrays of 0 and 1, ``body:NAME`` for volume cells, ``surface:NAME`` for facet
  cells and ``probe:NAME`` or ``probe:NAME@BODY`` for vertex cells;
- Abaqus INP, MED: element sets and groups, of volume cells for bodies, of shell cells for surfaces;
- MSH: named physical groups, of volumes for bodies, of surfaces for surfaces, and of one point,
  called ``probe:NAME`` or ``probe:NAME@BODY``, for each probe; a facet of several surfaces is
  repeated;
- all: a joint is the pair of surfaces ``JOINT.a`` and ``JOINT.b``.

The number of copies that make up the whole structure is in the case, not in these files.
"""

from __future__ import annotations

import re
import struct
import warnings
import zlib
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from xml.etree.ElementTree import ParseError

import meshio
import numpy as np
from meshio._exceptions import CorruptionError
from meshio.gmsh import _gmsh41
from numpy.typing import NDArray
from skfem import Mesh
from skfem.io.meshio import to_meshio

from meshes.structure import Probe, Structure
from meshes.volume_cells import boundary_facets, volume_mesh
from thermojoint.artefacts.errors import InputError, UnreadableError
from thermojoint.artefacts.files import whole_file

SUFFIXES = (".vtu", ".msh")
_READERS = {
    ".vtu": meshio.vtu.read,
    ".msh": meshio.gmsh.read,
    ".vtk": meshio.vtk.read,
    ".inp": meshio.abaqus.read,
    ".med": meshio.med.read,
}
Masks = list[NDArray[np.bool_]]
#: Type and corner nodes of each block of cells.
Cells = list[tuple[str, NDArray[np.int64]]]

_MSH_END = (
    rb"(^|\n)\$End(Comments|MeshFormat|PhysicalNames|(Partitioned)?Entities|Nodes|(Ghost)?Elements"
    rb"|Periodic|Parametrizations|NodeData|Element(Node)?Data|InterpolationScheme)$"
)
_ENDS = {".vtu": b"</VTKFile>$", ".msh": _MSH_END}
_DIMENSIONS = {"body": 3, "surface": 2, "probe": 0}
#: Cards of Abaqus files that create nodes and cells elsewhere, or move them.
_UNREAD_CARDS = ("INCLUDE", "SYSTEM", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY")
_FACET_CORNERS = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4}
#: Exceptions of meshio's readers for damaged files.
_DAMAGE = (
    meshio.ReadError,
    CorruptionError,
    ValueError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    AssertionError,
    RuntimeError,
    struct.error,
    zlib.error,
    ParseError,
    OSError,
    MemoryError,
    OverflowError,
)


def read_structure(path: Path | str, unit: float = 1.0) -> Structure:
    """Read a structure.

    Second-order cells keep their shape; straight ones are read by their corners. Nodes without a
    volume cell are left out.

    Parameters
    ----------
    path : Path or str
        File with one of the suffixes of `_READERS`; MSH of version 4.1 or 2.2.
    unit : float
        Length of one unit of its coordinates, m.

    Raises
    ------
    UnreadableError
        The file is missing or cannot be opened.
    InputError
        It is empty, truncated or of another kind; its cells are of several types, folded or without
        a body; a surface is not on the boundary; a probe is not a single point; the structure is
        larger than `meshes.volume_cells.LARGEST_EXTENT`.
    """
    path = Path(path)
    raw = _read(path)
    raw.points = unit * np.asarray(raw.points, dtype=float)
    mesh, renumber = volume_mesh(raw, path)
    surfaces = {
        name: boundary_facets(mesh, _corners(raw, masks, renumber, mesh, where), where)
        for name, masks in _names(raw, "surface", path).items()
        for where in [f"{path}: surface {name!r}"]
    }
    bodies, probes = _bodies(raw, path), _probes(raw, path)
    stems = [name.removesuffix(".a") for name in surfaces if name.endswith(".a")]
    try:
        return Structure(
            mesh=mesh,
            bodies=bodies,
            surfaces=surfaces,
            joints={s: (f"{s}.a", f"{s}.b") for s in stems if f"{s}.b" in surfaces},
            probes=probes,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def write_structure(structure: Structure, path: Path | str) -> None:
    """Write a structure, whole or not at all; cells, nodes and facets keep their order.

    Parameters
    ----------
    structure : Structure
        The structure; its ``symmetry_factor`` is not stored.
    path : Path or str
        ``.vtu``, or ``.msh`` (written in version 2.2, binary: meshio's 4.1 cannot represent a facet
        of several surfaces).

    Raises
    ------
    InputError
        The suffix is unknown, or a name cannot be represented in the file.
    """
    path = Path(path)
    _check_suffix(path, SUFFIXES)
    surfaces = _surfaces_with_joint_sides(structure)
    probes = {
        f"probe:{name}" + (f"@{probe.body}" if probe.body else ""): probe.position
        for name, probe in structure.probes.items()
    }
    _check_names([*structure.bodies, *surfaces, *structure.probes])
    volumes = to_meshio(structure.mesh, encode_cell_data=False)
    count = len(volumes.points)
    points = np.vstack([volumes.points, np.array(list(probes.values())).reshape(-1, 3)])
    vertices = count + np.arange(len(probes))[:, None]
    parts = (structure, surfaces, list(probes), volumes.cells[0], vertices)
    if path.suffix == ".vtu":
        cells, arrays = _as_arrays(*parts)
        grid = meshio.Mesh(points, cells, cell_data=arrays)
        with whole_file(path) as part:
            meshio.vtu.write(part, grid)
        return
    shared = set(structure.bodies) & set(surfaces)
    if shared:
        raise InputError(
            f"{path}: {min(shared)!r} is a body and a surface; MSH needs two names, or write VTU"
        )
    cells, tags, groups = _as_groups(*parts)
    data = {"gmsh:physical": tags, "gmsh:geometrical": [tag.copy() for tag in tags]}
    grid = meshio.Mesh(points, cells, cell_data=data, field_data=groups)
    with whole_file(path) as part:
        meshio.gmsh.write(part, grid, fmt_version="2.2", binary=True)


def _check_suffix(path: Path, known: Collection[str]) -> None:
    if path.suffix not in known:
        raise InputError(f"{path}: unknown suffix {path.suffix!r}; give one of {', '.join(known)}")


def _read(path: Path) -> meshio.Mesh:
    _check_suffix(path, _READERS)
    if not path.is_file():
        raise UnreadableError(f"{path}: no such mesh file; check its name")
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - 256))
            end = file.read().rstrip()
    except OSError as error:
        raise UnreadableError(f"{path}: cannot be read; check its permissions") from error
    # meshio accepts some truncated files.
    if not end or not re.search(_ENDS.get(path.suffix, b""), end):
        raise InputError(f"{path}: empty or truncated mesh file; write it again")
    if path.suffix == ".inp":
        _check_cards(path)
    if path.suffix == ".msh":
        _check_groups(path)
    try:
        # Not meshio.read, which prints and ends the process when a reader fails. Warnings of the
        # readers are covered by the checks below and in `volume_mesh`.
        with redirect_stderr(StringIO()), warnings.catch_warnings(action="ignore"):
            raw = _READERS[path.suffix](str(path))
            if path.suffix == ".msh":
                _add_reversed(raw, path)
            return raw
    except _DAMAGE as error:
        raise InputError(
            f"{path}: meshio cannot read it ({' '.join(str(error).split()) or 'damaged'}); "
            "write it again, from Gmsh with the physical groups only"
        ) from error


def _add_reversed(raw: meshio.Mesh, path: Path) -> None:
    """Add the entities that a physical group lists with a minus sign: meshio leaves them out."""
    ascii_file = True
    with path.open("rb") as file:
        for line in file:
            if line.startswith(b"$MeshFormat"):
                version, kind, size = next(file).split()
                if float(version) < 4.1:
                    return
                ascii_file = kind == b"0"
            elif line.startswith(b"$Entities"):
                groups_of, _ = _gmsh41._read_entities(file, ascii_file, int(size))
                break
        else:
            return
    for name, (tag, dimension) in raw.field_data.items():
        for k, block in enumerate(raw.cells):
            entity = raw.cell_data["gmsh:geometrical"][k][:1]
            if block.dim == dimension and entity.size and -tag in groups_of[dimension][entity[0]]:
                raw.cell_sets[name][k] = np.arange(len(block))


def _check_groups(path: Path) -> None:
    """Refuse MSH files with a name on several physical groups: meshio keeps only the last."""
    groups: dict[str, int] = {}
    with path.open("rb") as file:
        for line in file:
            if line.startswith((b"$EndPhysicalNames", b"$Nodes")):
                return
            given = re.fullmatch(rb'\s*(\d+)\s+\d+\s+"(.*)"\s*', line)
            if given is None:
                continue
            dimension, name = int(given[1]), given[2].decode(errors="replace")
            # Names of curves are not used, and among those of points only the ones of probes.
            if groups.get(name, 0) >= 2 or (name in groups and name.startswith("probe:")):
                raise InputError(
                    f"{path}: {name!r} is the name of two physical groups; give each its own"
                )
            groups[name] = dimension


def _check_cards(path: Path) -> None:
    """Refuse Abaqus files that meshio silently misreads.

    It ends a card at a comment, keeps only the last *NODE card and the last card of an element set,
    leaves elements below a set out of it, assigns sets of *ELEMENT cards to the first of these
    cards, and cannot combine sets. It does not move parts to their instances, and ignores what
    other cards create.
    """
    cards: list[tuple[str, str]] = []
    comment = False
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            if line.startswith("**"):
                comment = True
            elif line.startswith("*"):
                comment = False
                keyword, *words = line[1:].split(",")
                given = (word.partition("=") for word in words)
                values = {key.strip().upper(): value.strip() for key, _, value in given}
                cards.append((keyword.strip().upper(), values.get("ELSET", "")))
                if cards[-1][0] == "NODE" and values.get("SYSTEM", "R").upper() != "R":
                    raise InputError(
                        f"{path}: *NODE in another SYSTEM; write Cartesian coordinates"
                    )
            elif cards and cards[-1][0] == "INSTANCE" and line.strip():
                raise InputError(f"{path}: an *INSTANCE moves its part; write one flat file")
            elif cards and cards[-1][0] in ("NODE", "ELEMENT", "ELSET") and line.strip():
                card, name = cards[-1]
                first = line.strip().split(",")[0]
                if comment:
                    raise InputError(
                        f"{path}: a comment is inside a *{card} card; move it above the card"
                    )
                if card == "ELSET" and not first.isnumeric():
                    raise InputError(
                        f"{path}: element set {name!r} holds {first!r}, no number of an element; "
                        "list its elements"
                    )
    count = Counter(card for card, _ in cards)
    unread = [f"*{card}" for card in _UNREAD_CARDS if count[card]]
    unread += [f"several *{card} cards" for card in ("NODE", "INSTANCE") if count[card] > 1]
    if unread:
        raise InputError(f"{path}: {unread[0]} cannot be read; write one flat file")
    sets = Counter(name for card, name in cards if name and card in ("ELEMENT", "ELSET"))
    name, often = max(sets.items(), key=lambda item: item[1], default=("", 0))
    if often > 1:
        raise InputError(
            f"{path}: element set {name!r} is on {often} cards; define it by one *ELSET"
        )
    order = [card for card, _ in cards if card in ("ELEMENT", "ELSET")]
    if order != sorted(order):
        name = next(name for card, name in cards if card == "ELSET")
        raise InputError(
            f"{path}: element set {name!r} is above an *ELEMENT card, whose elements it would not "
            "hold; move the sets below all elements"
        )
    if len({bool(name) for card, name in cards if card == "ELEMENT"}) > 1:
        raise InputError(
            f"{path}: only some *ELEMENT cards have an ELSET; give every one its own, or none"
        )


def _blocks(raw: meshio.Mesh, dimension: int) -> list[int]:
    return [k for k, block in enumerate(raw.cells) if block.dim == dimension]


def _names(raw: meshio.Mesh, kind: str, path: Path) -> dict[str, Masks]:
    """Names of a kind, each with a mask for every block of cells of its dimension."""
    blocks = _blocks(raw, _DIMENSIONS[kind])
    if path.suffix in (".inp", ".med"):
        masks_by_name = {name: [masks[k] for k in blocks] for name, masks in _sets(raw).items()}
        return {name: masks for name, masks in masks_by_name.items() if any(m.any() for m in masks)}
    if path.suffix != ".msh":
        arrays = {
            name.removeprefix(f"{kind}:"): [np.ravel(values[k]) for k in blocks]
            for name, values in raw.cell_data.items()
            if name.startswith(f"{kind}:")
        }
        for name, values in arrays.items():
            if not all(np.isin(value, (0, 1)).all() for value in values):
                raise InputError(f"{path}: cell array '{kind}:{name}' must hold 0 and 1 only")
        return {name: [value != 0 for value in values] for name, values in arrays.items()}
    groups = {name: tag for name, (tag, of) in raw.field_data.items() if of == _DIMENSIONS[kind]}
    if kind == "probe":
        return {
            name.removeprefix("probe:"): _group(raw, name, tag, blocks)
            for name, tag in groups.items()
            if name.startswith("probe:")
        }
    return {name: _group(raw, name, tag, blocks) for name, tag in groups.items()}


def _sets(raw: meshio.Mesh) -> dict[str, Masks]:
    """Element sets of Abaqus, or groups of MED, as masks for every block of cells."""
    masks: dict[str, Masks] = {}

    def add(name: str, block: int, chosen: NDArray[np.bool_]) -> None:
        empty = [np.zeros(len(cells), dtype=bool) for cells in raw.cells]
        masks.setdefault(name, empty)[block] |= chosen

    for name, parts in raw.cell_sets.items():
        for block, members in enumerate(parts):
            if members is not None and len(members):
                add(name, block, np.isin(np.arange(len(raw.cells[block])), members))
    for tag, names in getattr(raw, "cell_tags", {}).items():
        for block, tags in enumerate(raw.cell_data.get("cell_tags", [])):
            for name in names:
                add(name, block, np.asarray(tags) == tag)
    return masks


def _group(raw: meshio.Mesh, name: str, tag: int, blocks: list[int]) -> Masks:
    masks = []
    for k in blocks:
        if name in raw.cell_sets:  # MSH 4.1: a block may be in several groups
            masks.append(np.isin(np.arange(len(raw.cells[k])), raw.cell_sets[name][k]))
        elif "gmsh:physical" in raw.cell_data:
            masks.append(np.asarray(raw.cell_data["gmsh:physical"][k]) == tag)
        else:
            masks.append(np.zeros(len(raw.cells[k]), dtype=bool))
    return masks


def _bodies(raw: meshio.Mesh, path: Path) -> dict[str, NDArray[np.int64]]:
    bodies = {
        name: np.flatnonzero(np.concatenate(masks))
        for name, masks in _names(raw, "body", path).items()
    }
    if not bodies:
        name = {
            ".msh": 'Physical Volume("NAME")',
            ".inp": "*ELEMENT, ELSET=NAME",
            ".med": "a group of volumes",
        }.get(path.suffix, "a cell array 'body:NAME'")
        raise InputError(f"{path}: no body has a name; name every body by {name}")
    empty = [name for name, cells in bodies.items() if not cells.size]
    if empty and path.suffix == ".msh":
        raise InputError(
            f"{path}: body {empty[0]!r} has no cells; with Mesh.SaveAll = 1 Gmsh writes MSH 2.2 "
            "without groups: write it again with the physical groups only"
        )
    return bodies


def _corners(
    raw: meshio.Mesh, masks: Masks, renumber: NDArray[np.int64], mesh: Mesh, where: str
) -> NDArray[np.int64]:
    """Corner nodes of the named facet cells, in the numbering of the mesh, shape (n, 3 or 4)."""
    count = mesh.facets.shape[0]
    blocks_of_corners = [np.empty((0, count), dtype=np.int64)]
    for k, mask in zip(_blocks(raw, 2), masks, strict=True):
        if not mask.any():
            continue
        block = raw.cells[k]
        if _FACET_CORNERS.get(block.type) != count:
            raise InputError(f"{where} has {block.type} facets, which no cell of the mesh has")
        blocks_of_corners.append(renumber[block.data[mask, :count]])
    return np.concatenate(blocks_of_corners)


def _probes(raw: meshio.Mesh, path: Path) -> dict[str, Probe]:
    vertices = [raw.cells[k].data[:, 0] for k in _blocks(raw, 0)]
    probes = {}
    for label, masks in _names(raw, "probe", path).items():
        named = [nodes[mask] for nodes, mask in zip(vertices, masks, strict=True)]
        at = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *named]))
        if at.size != 1:
            raise InputError(f"{path}: probe {label!r} has {at.size} points; give it one")
        x, y, z = (float(value) for value in raw.points[at[0]])
        name, _, body = label.partition("@")
        if name in probes:
            raise InputError(f"{path}: two probes have the name {name!r}; give each its own")
        probes[name] = Probe((x, y, z), body or None)
    return probes


def _surfaces_with_joint_sides(structure: Structure) -> dict[str, NDArray[np.int64]]:
    surfaces = dict(structure.surfaces)
    for joint, sides in structure.joints.items():
        for letter, side in zip("ab", sides, strict=True):
            name, facets = f"{joint}.{letter}", structure.surfaces[side]
            if not np.array_equal(np.sort(surfaces.get(name, facets)), np.sort(facets)):
                raise InputError(
                    f"surface {name!r} is not side {letter} of joint {joint!r}; rename one of them"
                )
            surfaces[name] = facets
    for name in surfaces:
        stem = name.removesuffix(".a")
        if stem != name and f"{stem}.b" in surfaces and stem not in structure.joints:
            raise InputError(
                f"surfaces '{stem}.a' and '{stem}.b' would be read as a joint; rename them"
            )
    return surfaces


def _check_names(names: list[str]) -> None:
    for name in names:
        # meshio does not escape names in XML and MSH, and '@' and ':' are separators.
        if not re.fullmatch(r"[A-Za-z0-9_.+-]+", name):
            raise InputError(
                f"name {name!r} cannot be kept in a mesh file; use letters, digits and _ . + -"
            )


def _cells(
    mesh: Mesh, volumes: meshio.CellBlock, facets: NDArray[np.int64], vertices: NDArray[np.int64]
) -> Cells:
    """Volume cells, facet cells and vertex cells, as in files."""
    facet_type = "quad" if mesh.facets.shape[0] == 4 else "triangle"
    return [
        (volumes.type, volumes.data),
        (facet_type, mesh.facets[:, facets].T),
        ("vertex", vertices),
    ]


def _as_arrays(
    structure: Structure,
    surfaces: Mapping[str, NDArray[np.int64]],
    probes: list[str],
    volumes: meshio.CellBlock,
    vertices: NDArray[np.int64],
) -> tuple[Cells, dict[str, list[NDArray[np.int8]]]]:
    """Cells and arrays of 0 and 1 for VTU."""
    mesh = structure.mesh
    facets = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *surfaces.values()]))
    cells = _cells(mesh, volumes, facets, vertices)
    owners = [np.arange(mesh.nelements), facets, np.arange(len(probes))]
    named = [
        {f"body:{name}": chosen for name, chosen in structure.bodies.items()},
        {f"surface:{name}": chosen for name, chosen in surfaces.items()},
        {name: np.array([i]) for i, name in enumerate(probes)},
    ]
    arrays = {
        name: [
            np.isin(owner, chosen if kind == i else []).astype(np.int8)
            for i, owner in enumerate(owners)
        ]
        for kind, group in enumerate(named)
        for name, chosen in group.items()
    }
    kept = [i for i, (_, nodes) in enumerate(cells) if len(nodes)]
    return [cells[i] for i in kept], {
        name: [blocks[i] for i in kept] for name, blocks in arrays.items()
    }


def _as_groups(
    structure: Structure,
    surfaces: Mapping[str, NDArray[np.int64]],
    probes: list[str],
    volumes: meshio.CellBlock,
    vertices: NDArray[np.int64],
) -> tuple[Cells, list[NDArray[np.int32]], dict[str, NDArray[np.int64]]]:
    """Cells, the tag of each, and (tag, dimension) of each name, for MSH 2.2."""
    mesh = structure.mesh
    body_tag = np.zeros(mesh.nelements, dtype=np.int32)
    for tag, chosen in enumerate(structure.bodies.values(), start=1):
        body_tag[chosen] = tag
    facets = [np.empty(0, dtype=np.int64), *surfaces.values()]
    cells = _cells(mesh, volumes, np.hstack(facets), vertices)
    tags = [
        body_tag,
        np.repeat(np.arange(len(facets), dtype=np.int32), [len(part) for part in facets]),
        np.arange(1, len(probes) + 1, dtype=np.int32),
    ]
    groups = {
        name: np.array([tag, dimension])
        for dimension, names in ((3, structure.bodies), (2, surfaces), (0, probes))
        for tag, name in enumerate(names, start=1)
    }
    kept = [i for i, (_, nodes) in enumerate(cells) if len(nodes)]
    return [cells[i] for i in kept], [tags[i] for i in kept], groups
