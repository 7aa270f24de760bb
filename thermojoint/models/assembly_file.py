"""File of an assembled estimator with its fingerprint, read back bit for bit.

Estimators on other processors or controls read this file, without any fitting.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.json_file import JsonKind, read_json, without_header, write_json
from thermojoint.models.assembly import Assembly
from thermojoint.models.filters.bank import Bank
from thermojoint.models.parameters import Model

FILE = JsonKind(
    "thermojoint-assembly",
    2,
    "assembled estimator",
    "written by 'thermojoint assemble'",
    "assemble again",
)
KIND = "fchs"

_MODEL: TypeAdapter[Model] = TypeAdapter(Model)
_BANKS = ("heat", "linear", "temperature", "sources", "nonlinear")
_ARRAYS = tuple(field.name for field in fields(Bank) if field.name not in ("leak", "error"))
_COMPLEX = ("poles", "gain", "double")


def write_assembly(assembly: Assembly, path: Path | str) -> None:
    """Write an assembly, whole or not at all.

    Parameters
    ----------
    assembly : Assembly
        Result of `thermojoint.models.assembly.assemble`.
    path : Path or str
        JSON to write.
    """
    write_json(path, as_content(assembly), indent=1)


def read_assembly(path: Path | str) -> Assembly:
    """Read an assembly.

    Parameters
    ----------
    path : Path or str
        JSON written by `write_assembly`.

    Raises
    ------
    InputError
        The file is missing, truncated, not an assembly, of another version, or was changed.
    """
    return _assembly(read_json(path, FILE), str(path))


def as_content(assembly: Assembly) -> dict[str, Any]:
    """Return an assembly as plain data, with its fingerprint."""
    body = {
        "kind": KIND,
        "dt_s": assembly.dt_s,
        "run_length_s": assembly.run_length_s,
        "model": _MODEL.dump_python(assembly.model, mode="json"),
        "banks": {name: _bank_content(getattr(assembly, name)) for name in _BANKS},
    }
    return FILE.header | body | {"fingerprint": _digest(body)}


def from_content(content: Any, where: str) -> Assembly:  # noqa: ANN401
    """Return the assembly from plain data.

    Raises
    ------
    InputError
        As `read_assembly`.
    """
    return _assembly(without_header(content, FILE, where), where)


def _assembly(content: dict[str, Any], where: str) -> Assembly:
    if content.get("kind") != KIND:
        raise InputError(f"{where}: assembly of kind {content.get('kind')!r}, expected {KIND!r}")
    body = {key: value for key, value in content.items() if key != "fingerprint"}
    if content.get("fingerprint") != _digest(body):
        raise InputError(f"{where}: does not match its fingerprint, it was changed; assemble again")
    try:
        return Assembly(
            model=_MODEL.validate_json(json.dumps(body["model"])),
            dt_s=float(body["dt_s"]),
            run_length_s=float(body["run_length_s"]),
            **{name: _bank(body["banks"][name]) for name in _BANKS},
        )
    except (KeyError, TypeError, ValueError, ValidationError) as error:
        raise InputError(f"{where}: the assembly's values are damaged; assemble again") from error


def fingerprint(assembly: Assembly) -> str:
    """Return the digest of all coefficients; a state is valid for one fingerprint only."""
    return str(as_content(assembly)["fingerprint"])


def _digest(body: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _bank_content(bank: Bank) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for name in _ARRAYS:
        array = np.asarray(getattr(bank, name))
        split = np.stack((array.real, array.imag), axis=-1) if name in _COMPLEX else array
        content[name] = {"shape": list(array.shape), "values": split.ravel().tolist()}
    # Files of earlier versions have no error, and keep their fingerprint.
    return content | {"leak": bank.leak} | ({"error": bank.error} if bank.error else {})


def _bank(content: dict[str, Any]) -> Bank:
    arrays = {name: _array(name, content[name]) for name in _ARRAYS}
    return Bank(**arrays, leak=float(content["leak"]), error=float(content.get("error", 0.0)))


def _array(name: str, content: dict[str, Any]) -> Array:
    values, shape = np.array(content["values"], dtype=float), tuple(content["shape"])
    if name not in _COMPLEX:
        return values.reshape(shape)
    parts = values.reshape((*shape, 2))
    whole: Any = np.empty(shape, dtype=complex)
    # Not real + 1j * imag, which loses the sign of a zero.
    whole.real, whole.imag = parts[..., 0], parts[..., 1]
    return np.asarray(whole)
