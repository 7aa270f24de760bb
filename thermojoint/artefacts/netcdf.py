"""NetCDF files of named arrays, written by h5py alone.

xarray writes the same file through h5netcdf, whose repeated look-up of every dimension of every
variable takes longer than writing the content.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np

#: Name of a dimension without a variable, followed by its length.
_UNNAMED = "This is a netCDF dimension but not a netCDF variable."
#: With the shuffle filter floats compress better, and the fastest level suffices.
_PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


class Variable(NamedTuple):
    """An array with the names of its dimensions and its metadata, such as its unit."""

    dims: tuple[str, ...]
    values: np.ndarray
    attrs: Mapping[str, Any]

    def to_numpy(self) -> np.ndarray:
        """Return the values; named as in xarray."""
        return self.values


def netcdf_bytes(variables: Mapping[str, Variable], attrs: Mapping[str, Any]) -> bytes:
    """Return the content of a NetCDF-4 file.

    Parameters
    ----------
    variables : mapping
        Numbers and text.
    attrs : mapping
        Metadata of the file: numbers and text.
    """
    import h5py

    made = BytesIO()
    sizes = {
        dim: size
        for variable in variables.values()
        for dim, size in zip(variable.dims, variable.values.shape, strict=True)
    }
    with h5py.File(made, "w", track_order=True) as file:
        written = {
            name: _written(file, name, variable, {} if name in sizes else _PACKED)
            for name, variable in variables.items()
        }
        for number, (dim, size) in enumerate(sizes.items()):
            if dim in written:
                written[dim].make_scale(dim)
            else:
                written[dim] = file.create_dataset(dim, (size,), "f4")
                written[dim].make_scale(f"{_UNNAMED}{size:10d}")
            written[dim].attrs["_Netcdf4Dimid"] = np.int32(number)
        for name, variable in variables.items():
            for at, dim in enumerate(() if name in sizes else variable.dims):
                written[name].dims[at].attach_scale(written[dim])
        _describe(file, attrs)
    return made.getvalue()


def _written(file: Any, name: str, variable: Variable, floats: Mapping[str, Any]) -> Any:  # noqa: ANN401 - h5py
    """Write a variable without its dimensions, with options for floats."""
    import h5py

    values, attrs = variable.values, dict(variable.attrs)
    options: Mapping[str, Any] = {}
    if values.dtype.kind in "OU":
        values = values.astype(h5py.string_dtype())
    elif values.dtype.kind == "f":
        attrs.setdefault("_FillValue", np.nan)
        options = floats if values.size else {}
    written = file.create_dataset(name, data=values, **options)
    _describe(written, attrs)
    return written


def _describe(written: Any, attrs: Mapping[str, Any]) -> None:  # noqa: ANN401 - h5py
    for name, value in attrs.items():
        # NetCDF has no single numbers, only arrays of one.
        written.attrs[name] = value if isinstance(value, str) else np.atleast_1d(value)
