"""LinuxCNC: the files that make a control apply the offsets of a machine to its axes.

The component (`thermojoint.live.targets.linuxcnc_component`), a HAL file that loads it, and the
control's ini file with the line that loads the HAL file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.units import MEGA
from thermojoint.compensation.offsets.settings import Settings, read_settings
from thermojoint.live.ip_address import in_url
from thermojoint.live.settings import HttpServer, Service

#: Names of the installed files.
COMPONENT, HAL_FILE = "thermojoint_hal.py", "thermojoint.hal"
_UNITS_PER_MM = {"mm": 1.0, "metric": 1.0, "inch": 1 / 25.4, "in": 1 / 25.4, "imperial": 1 / 25.4}
_LOADS = f"HALFILE = {HAL_FILE}"
_LOADUSR = "loadusr -Wn thermojoint "
_HAL = """\
# Offsets of the machine {machine} from the thermojoint service.
{loadusr}
# The axes move while this signal is TRUE: leave it so, or link it to a switch.
sets thermojoint-on TRUE
"""


def files_for(
    service: Service, machine: str, ini: Path, token: Path, url: str | None
) -> dict[Path, str]:
    """Return the contents of the files to write, by name.

    `ini` is the control's ini file; `token` has a token of the service with the role operator,
    readable by the control's user. The control reaches the service at `url`; None: at that of the
    service's file.

    Raises
    ------
    InputError
        The machine has no offsets or no handshake by HTTP, its axes are not those of the control,
        the control reserves no speed for offsets, or the HAL file was not written by this command.
    """
    http, output = _settings_of(service, machine)
    text = _text_of(ini, "name the control's ini file")
    given = entries_of(text)
    for axis in output.output.names:
        _check_axis(axis, given, ini)
    unit = given.get("TRAJ.LINEAR_UNITS", "").lower()
    if unit not in _UNITS_PER_MM:
        raise InputError(f"{ini}: [TRAJ]LINEAR_UNITS is {unit or 'missing'}; write mm or inch")
    options = {
        "url": _url_of(http) if url is None else url.rstrip("/"),
        "machine": machine,
        "token-file": token.absolute(),
        "axes": "".join(output.output.names).lower(),
        "rate-um-s": f"{MEGA * output.output.rate:.6g}",
        "largest-um": f"{MEGA * output.output.largest:.6g}",
        "hold-s": f"{output.output.freeze_time:g}",
        "units-per-mm": f"{_UNITS_PER_MM[unit]:.9g}",
    }
    if http.security == "tls":
        options["ca-file"] = http.certificate_file or service.folder / "http_certificate.pem"
    component = ini.absolute().parent / COMPONENT
    hal_file = component.with_name(HAL_FILE)
    words = [str(component), *(f"--{name}={value}" for name, value in options.items())]
    if spaced := [word for word in words if len(word.split()) != 1]:
        raise InputError(f"{spaced[0]}: HAL files know no spaces; take another place or name")
    source = files("thermojoint.live.targets").joinpath("linuxcnc_component.py")
    loading = with_hal_file(text, ini)
    return {
        component: source.read_text("utf-8"),
        hal_file: _hal_text(hal_file, machine, _LOADUSR + " ".join(words)),
        **({} if loading == text else {ini.with_name(f"{ini.name}.former"): text}),
        ini: loading,
    }


def _text_of(path: Path, advice: str) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not readable ({error}); {advice}") from error


def _hal_text(path: Path, machine: str, loadusr: str) -> str:
    """Return the HAL file with a line that loads the component.

    Other lines of an existing file are kept: its signal may be linked to a switch.
    """
    if not path.exists():
        return _HAL.format(machine=machine, loadusr=loadusr)
    lines = _text_of(path, "move the file away").splitlines()
    at = [k for k, line in enumerate(lines) if line.startswith(_LOADUSR)]
    if len(at) != 1:
        raise InputError(
            f"{path}: {len(at)} lines {_LOADUSR.strip()!r} in place of one; move the file away"
        )
    return "\n".join([*lines[: at[0]], loadusr, *lines[at[0] + 1 :]]) + "\n"


def _settings_of(service: Service, machine: str) -> tuple[HttpServer, Settings]:
    section = service.machines.get(machine)
    if section is None:
        raise unknown_name("machine", machine, service.machines, "service")
    offsets, http = service.given.models[section.model].offsets, service.given.http
    if offsets is None:
        raise InputError(f"models.{section.model}: sends no offsets; give it offsets")
    if http is None or section.handshake is None or section.handshake.by != "http":
        raise InputError(
            f'machines.{machine}: LinuxCNC answers by HTTP; add [http] and handshake.by = "http"'
        )
    settings = read_settings(offsets)
    for axis in settings.slopes:
        raise InputError(
            f"{offsets}: axes.{axis}.slope: LinuxCNC takes one offset for all positions; leave the "
            "slope out"
        )
    return http, settings


def _url_of(http: HttpServer) -> str:
    """Return the URL at which a control on the same computer reaches the service."""
    host = "127.0.0.1" if http.address in ("0.0.0.0", "::") else http.address
    scheme = "https" if http.security == "tls" else "http"
    return f"{scheme}://{in_url(host)}:{http.port}"


def entries_of(text: str) -> Mapping[str, str]:
    """Return the entries of an ini file as SECTION.NAME to value, the last one of each name."""
    found, section = {}, ""
    for line in text.splitlines():
        if match := re.fullmatch(r"\s*\[(\w+)\]\s*", line):
            section = match[1].upper()
        elif match := re.fullmatch(r"\s*(\w+)\s*=\s*(.*?)\s*", line):
            found[f"{section}.{match[1].upper()}"] = match[2]
    return found


def _check_axis(axis: str, given: Mapping[str, str], ini: Path) -> None:
    """Refuse an axis that the control lacks, or that offsets cannot move."""
    # The component acknowledges by the axis letters of the control.
    section = f"AXIS_{axis}"
    if not any(name.startswith(f"{section}.") for name in given):
        raise InputError(f"{ini}: there is no [{section}]; name the axes in the offsets as here")
    ratio = given.get(f"{section}.OFFSET_AV_RATIO", "0")
    if not re.fullmatch(r"0?\.\d+", ratio) or not 0.0 < float(ratio) <= 0.9:
        raise InputError(
            f"{ini}: [{section}]OFFSET_AV_RATIO is {ratio}, and the control ignores offsets; write "
            "a share of speed and acceleration up to 0.9, such as 0.1"
        )


def with_hal_file(text: str, ini: Path) -> str:
    """Return an ini file that loads the HAL file after the ones loaded already."""
    lines = text.splitlines()
    if _LOADS in lines:
        return text
    others = [k for k, line in enumerate(lines) if re.match(r"\s*HALFILE\s*=", line)]
    if not others:
        raise InputError(f"{ini}: [HAL] has no HALFILE; name the control's ini file")
    return "\n".join([*lines[: others[-1] + 1], _LOADS, *lines[others[-1] + 1 :]]) + "\n"
