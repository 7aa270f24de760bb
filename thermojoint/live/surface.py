"""Surface of a joint-aware model's machine with temperatures and pressures, for display.

A model has no mesh. A surface file contains the part of the mesh that a picture needs: the outer
faces, the map from the model's amplitudes to the temperature at their corners, and the contact
elements:

    T = rows a,   rows = (basis of the case at the corners) (rotation to the model's modes).
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import fingerprint
from estimator.joint_aware.observer_model import ObserverModel
from estimator.joint_aware.observer_state import unpacked
from fesim.case.schema import Case
from fesim.outside import contacts_of, outside_of
from fesim.setup.machine import Setup
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_bytes
from thermojoint.reduced.machine import Modes, along, diagonal_basis, on_basis, reduce_machine
from thermojoint.reduced.parameters import with_factors

SCHEMA = "thermojoint-surface"
SCHEMA_VERSION = 1
#: Relative difference below which rates count as equal: their modes may be any rotation.
ALIKE = 1e-6
#: Relative tolerance to which the modes must reproduce the model's sensors and sources.
SAME = 1e-5
_ARRAYS = ("points", "triangles", "rows", "contact_points", "contact_triangles", "contacts", "up")


@dataclass(frozen=True, eq=False)
class Surface:
    """Data of a picture; n corners, t triangles, r modes."""

    #: Fingerprint of its model.
    model: str
    #: Shape (n, 3): corners, m.
    points: Array
    #: Shape (t, 3): indices of corners.
    triangles: NDArray[np.int64]
    #: Shape (n, r): temperature at the corners per amplitude, single precision.
    rows: NDArray[np.float32]
    #: The same for side a of all joints.
    contact_points: Array
    contact_triangles: NDArray[np.int64]
    #: Contact element of each of these triangles.
    contacts: NDArray[np.int64]
    #: Shape (3,): upward direction.
    up: Array


def surface_of(case: Case, setup: Setup, model: ObserverModel, up: Array) -> Surface:
    """Return the surface of the machine of a model, with its upward direction `up`, shape (3,).

    The case is the one with which the model was calibrated.

    Raises
    ------
    InputError
        The model was calibrated with another case, or another mesh of it.
    """
    machine = along(reduce_machine(case, setup, model.sensors), model.axes)
    fitted = with_factors(machine, {name: factor for name, (factor, _) in model.factors.items()})
    rates, turn = diagonal_basis(fitted, model.held)
    modes = on_basis(fitted, rates, turn, model.held)
    if not _alike(modes, model.modes):
        raise InputError("scene: the model was calibrated with another case or mesh; give its own")
    aligned = _alignment(modes, model.modes)
    wanted = model.modes.sensors
    if not np.allclose(modes.sensors @ aligned, wanted, atol=SAME * np.abs(wanted).max()):
        raise InputError("scene: the model was calibrated with another case or mesh; give its own")
    assert setup.modes is not None  # reduce_machine needs them
    outside, contacts = outside_of(setup), contacts_of(setup)
    return Surface(
        model=fingerprint(model),
        points=outside.points,
        triangles=outside.corners,
        # The last modes, of sensors with a lag, are not temperatures of the machine.
        rows=np.asarray(
            setup.modes.basis[outside.of] @ turn @ aligned[: rates.size, : rates.size],
            dtype=np.float32,
        ),
        contact_points=contacts.points,
        contact_triangles=contacts.corners,
        contacts=contacts.of,
        up=np.asarray(up, dtype=float),
    )


def _alike(modes: Modes, model: Modes) -> bool:
    """Return whether modes have the array shapes and rates of a model's modes."""
    return (
        modes.rates.shape == model.rates.shape
        and modes.jump.shape == model.jump.shape
        and bool(np.allclose(modes.rates, model.rates, rtol=SAME, atol=SAME * model.rates.max()))
    )


def _alignment(modes: Modes, model: Modes) -> Array:
    """Return the rotation of modes of equal rates (at least their sign) to a model's, shape (r, r).

    The nearest orthogonal matrix (Procrustes), by sensors, joints and inputs.
    """
    seen, wanted = (
        np.vstack(
            [rows / max(np.abs(rows).max(), 1e-300) for rows in (m.sensors, m.jump, m.drive.T)]
        )
        for m in (modes, model)
    )
    begins = np.flatnonzero(np.abs(np.diff(modes.rates)) > ALIKE * modes.rates[1:]) + 1
    turn = np.zeros((modes.rates.size, modes.rates.size))
    for group in np.split(np.arange(modes.rates.size), begins):
        left, _, right = np.linalg.svd(seen[:, group].T @ wanted[:, group])
        turn[np.ix_(group, group)] = left @ right
    return turn


def temperatures(surface: Surface, estimator: JointAware, state: Array) -> Array:
    """Return the temperature at every corner above the initial ambient, K, shape (n,)."""
    amplitudes = unpacked(state, estimator.parts).linear[: surface.rows.shape[1]]
    return np.asarray(surface.rows @ amplitudes.astype(np.float32), dtype=float)


def pressures(surface: Surface, estimator: JointAware, state: Array) -> Array:
    """Return the pressure in every triangle of the joints, Pa."""
    return np.asarray(unpacked(state, estimator.parts).pressure[surface.contacts])


def write_surface(surface: Surface, path: Path) -> None:
    """Write a surface to `path` (HDF5), whole or not at all."""
    made = BytesIO()
    with h5py.File(made, "w") as file:
        for name in _ARRAYS:
            file.create_dataset(name, data=getattr(surface, name), compression="gzip")
        file.attrs["schema"], file.attrs["schema_version"] = SCHEMA, SCHEMA_VERSION
        file.attrs["model"] = surface.model
    write_bytes(Path(path), made.getvalue())


def read_surface(path: Path, model: ObserverModel) -> Surface:
    """Read the surface of a model.

    Raises
    ------
    InputError
        The file is missing, damaged, not a surface, or of another model.
    """
    path = Path(path)
    again = "write it with 'thermojoint scene'"
    if not path.is_file():
        raise InputError(f"{path}: no such file; {again}")
    try:
        with h5py.File(path, "r") as file:
            header = file.attrs["schema"], int(file.attrs["schema_version"])
            of = str(file.attrs["model"])
            arrays = {name: np.asarray(file[name][()]) for name in _ARRAYS}
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: no readable surface of a machine; {again}") from error
    if header != (SCHEMA, SCHEMA_VERSION):
        raise InputError(f"{path}: no surface of version {SCHEMA_VERSION}; {again}")
    if of != fingerprint(model):
        raise InputError(f"{path}: the surface of another model; {again} of this one")
    return Surface(of, **arrays)
