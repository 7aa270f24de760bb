"""Export as an FMU for co-simulation (FMI 2.0 or 3.0) with sources and binary."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
import zipfile
from enum import StrEnum
from pathlib import Path

from estimator.export.c_source import c_files, environment
from estimator.export.program import Program
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import temporary_folder, whole_file


class Standard(StrEnum):
    """The version of FMI."""

    FMI2 = "fmi2"
    FMI3 = "fmi3"


#: Types of FMI 3.0 without numbers, and their C names.
_OTHERS = (
    ("Float32", "float"),
    *((f"Int{bits}", f"int{bits}_t") for bits in (8, 16, 32, 64)),
    *((f"UInt{bits}", f"uint{bits}_t") for bits in (8, 16, 32, 64)),
    ("Boolean", "bool"),
)
#: Units as exponents of the base units, in FMI notation.
BASES = {
    "1": "",
    "m/m": "",
    "K": ' K="1"',
    "m": ' m="1"',
    "W": ' kg="1" m="2" s="-3"',
    "Pa": ' kg="1" m="-1" s="-2"',
    "rad/s": ' rad="1" s="-1"',
    "m/s": ' m="1" s="-1"',
    "A": ' A="1"',
    "N m": ' kg="1" m="2" s="-2"',
}
#: Date of every member of the archive, fixed so that the same program gives the same bytes.
_DATE = (1980, 1, 1, 0, 0, 0)


def write_fmu(program: Program, path: Path | str, standard: Standard = Standard.FMI3) -> None:
    """Compile a program and write the unit, whole or not at all.

    Parameters
    ----------
    program : Program
        From `export_program`.
    path : Path or str
        The archive to write.
    standard : Standard
        Version of FMI.

    Raises
    ------
    InputError
        No C compiler is installed, compiling fails, or FMUs cannot be built on this platform.
    """
    place = _platform(standard)
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        raise InputError("--to fmu: needs a C compiler; install gcc, or export with --to c")
    sources = c_files(program) | fmi_files(program, standard)
    description = sources.pop("modelDescription.xml")
    name = program.name
    with temporary_folder() as folder:
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        command = [
            compiler,
            "-std=c99",
            "-O3",
            "-shared",
            "-fPIC",
            f"{name}.c",
            f"{name}_{standard}.c",
        ]
        done = subprocess.run(
            [*command, "-lm", "-o", "library"], cwd=folder, capture_output=True, check=False
        )
        if done.returncode:
            raise InputError(f"--to fmu: {compiler} failed: {done.stderr.decode()[:200]}")
        library = (folder / "library").read_bytes()
    with (
        whole_file(Path(path)) as part,
        zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        members = {"modelDescription.xml": description.encode()}
        members |= {f"sources/{file}": text.encode() for file, text in sources.items()}
        members[f"binaries/{place}/{name}.so"] = library
        for member, content in members.items():
            entry = zipfile.ZipInfo(member, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)


def fmi_files(program: Program, standard: Standard) -> dict[str, str]:
    """Return the files beside the program itself: descriptions, and NAME_fmi2.c or NAME_fmi3.c."""
    templates, interface = environment(program.precision), program.interface
    values = {
        "name": program.name,
        "kind": interface.kind,
        "fingerprint": interface.fingerprint,
        "guid": f"{{{interface.kind}-{program.precision}-{interface.fingerprint}}}",
        "version": program.version,
        "interval": repr(interface.interval),
        "timed": interface.timed,
        "inputs": interface.inputs,
        "outputs": interface.outputs,
        "units": sorted({variable.unit for variable in (*interface.inputs, *interface.outputs)}),
        "bases": BASES,
        "others": _OTHERS,
    }
    written = {"modelDescription.xml": f"{standard}.xml.j2"}
    written[f"{program.name}_{standard}.c"] = f"{standard}.c.j2"
    if standard is Standard.FMI3:
        written["buildDescription.xml"] = "fmi3_build.xml.j2"
    return {name: templates.get_template(form).render(values) for name, form in written.items()}


def _platform(standard: Standard) -> str:
    """Name of the folder for libraries of this platform."""
    if sys.platform == "linux" and platform.machine() == "x86_64":
        return "linux64" if standard is Standard.FMI2 else "x86_64-linux"
    raise InputError(
        "--to fmu: a unit is made on 64-bit Linux on x86; export it there, or with --to c"
    )
