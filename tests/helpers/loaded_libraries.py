"""What most commands need, loaded as they load it: for the server of `own_process`."""

from importlib import import_module

from compiled_once import compile_once

from thermojoint.artefacts.process_start import prepare_process

prepare_process()
for _name in (
    "fesim.march.kernel",
    "fesim.simulate",
    "h5netcdf.core",
    "thermojoint.artefacts.response",
    "thermojoint.cli.app",
    "thermojoint.live.service",
    "xarray",
):
    import_module(_name)
compile_once()
