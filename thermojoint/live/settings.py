"""Settings file of a service (TOML): machines, models, sources and outputs.

Units are in the names of the keys. The file contains no secrets, only their locations.
"""

from __future__ import annotations

import ipaddress
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.settings import toml
from thermojoint.artefacts.settings.read import settings_from
from thermojoint.artefacts.settings.section import File, NotNegative, Positive, Section, Texts

Port = Annotated[int, Field(ge=0, le=65535)]

#: Form of a machine's name, which is part of topics, node ids, URLs and file names.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
#: URL of an agent.
_HTTP = re.compile(r"https?://(\[[0-9A-Fa-f:]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?(/[A-Za-z0-9._~/-]*)?")
#: Largest number of machines of one service.
MOST_MACHINES = 10_000


class Secret(Section):
    """Location of a secret: ``{ file = "..." }``, or ``variable`` or ``credential`` instead.

    A credential is one of systemd's (``LoadCredential=``).
    """

    file: File | None = None
    variable: str | None = None
    credential: str | None = None

    @model_validator(mode="after")
    def _one(self) -> Secret:
        if sum(place is not None for place in (self.file, self.variable, self.credential)) != 1:
            raise ValueError("a secret is kept in one place; give file, variable or credential")
        return self


class NextReadingSection(Section):
    """``[models.NAME.next_reading]``: readings are requested when the band exceeds a limit."""

    above_um: Positive
    interval_min: NotNegative = 60.0


class ModelSection(Section):
    """``[models.NAME]``: an estimator, for any number of machines."""

    file: File
    interval_s: Positive = 1.0
    run_length_min: Positive = 120.0
    reads: Literal["thermometers", "above-ambient"] = "thermometers"
    offsets: File | None = None
    scene: File | None = None
    next_reading: NextReadingSection | None = None
    lateness_s: NotNegative = 5.0
    hold_s: NotNegative = 0.0


class HandshakeSection(Section):
    """``[machines.NAME.handshake]``: offsets only follow while the control confirms them.

    The control answers by OPC UA or HTTP, as a user who may write, or by MQTT; or the service reads
    the answer from the target that it writes to.
    """

    by: Literal["opcua", "mqtt", "http", "target"]
    user: str | None = None
    heartbeat_s: Positive = 5.0
    differs_um: Positive | None = None
    differs_s: Positive = 5.0


class IdentificationSection(Section):
    """``[machines.NAME.identification]``: identification of the machine by OPC 40001-1.

    ``{machine}`` in a text is the name of the machine.
    """

    manufacturer: str
    serial_number: str
    product_instance_uri: str
    manufacturer_uri: str | None = None
    model: str | None = None
    product_code: str | None = None
    hardware_revision: str | None = None
    software_revision: str | None = None
    device_class: str | None = None
    asset_id: str | None = None
    component_name: str | None = None
    location: str | None = None
    year_of_construction: Annotated[int, Field(ge=1800, le=9999)] | None = None


class MachineSection(Section):
    """``[machines.NAME]``: one machine, or with ``count`` NAME-1, NAME-2, ..."""

    model: str
    source: str
    handshake: HandshakeSection | None = None
    target: File | None = None
    identification: IdentificationSection | None = None
    count: Annotated[int, Field(ge=1, le=MOST_MACHINES)] | None = None


class CsvSource(Section):
    """Lines of a file that grows, of a FIFO, or of standard input (``-``)."""

    kind: Literal["csv"]
    path: File
    columns: dict[str, str] = {}
    starts: str | None = None
    follow: bool = True


class MqttAddress(Section):
    """Connection to a broker."""

    host: str = "127.0.0.1"
    port: Port = 8883
    security: Literal["tls", "none"] = "tls"
    ca_file: File | None = None
    user: str | None = None
    password: Secret | None = None
    client_id: str = "thermojoint"


class MqttSource(MqttAddress):
    """Messages of a broker, each a JSON object with a time and readings."""

    kind: Literal["mqtt"]
    topic: str
    columns: dict[str, str] = {}
    largest_message: Annotated[int, Field(ge=64, le=1 << 20)] = 16_384
    most_waiting: Annotated[int, Field(ge=1, le=1_000_000)] = 10_000


class OpcuaAddress(Section):
    """Connection to an OPC UA server."""

    url: str
    security: Literal["sign-and-encrypt", "none"] = "sign-and-encrypt"
    server_certificate: File | None = None
    user: str | None = None
    password: Secret | None = None


class OpcuaSource(OpcuaAddress):
    """Variables of an OPC UA server."""

    kind: Literal["opcua"]
    node: str
    columns: dict[str, str] = {}
    publishing_ms: Positive = 200.0
    most_waiting: Annotated[int, Field(ge=1, le=1_000_000)] = 100_000


class MtconnectSource(Section):
    """Data items of an MTConnect agent, or of an adapter behind it."""

    kind: Literal["mtconnect"]
    url: str
    ca_file: File | None = None
    device: str = "{machine}"
    columns: dict[str, str] = {}
    unchanged_s: Positive | None = None


Source = Annotated[
    CsvSource | MqttSource | OpcuaSource | MtconnectSource, Field(discriminator="kind")
]


#: Key that locates the readings of a machine, by the kind of its source.
_LOCATING = {"csv": "path", "mqtt": "topic", "opcua": "node", "mtconnect": "device"}


class WatchdogSection(Section):
    """``[watchdog]``: times without a sample after which a value is uncertain, then bad."""

    uncertain_s: Positive = 10.0
    bad_s: Positive = 60.0

    @model_validator(mode="after")
    def _in_order(self) -> WatchdogSection:
        if self.bad_s <= self.uncertain_s:
            raise ValueError("bad_s does not come after uncertain_s; make it larger")
        return self


class StoreSection(Section):
    """``[store]``: checkpoints, length of the history, durability, reserve for a full disk."""

    checkpoint_s: Positive = 60.0
    keep_days: Positive = 7.0
    durable: bool = False
    reserve_h: NotNegative = 8.0


class AuditSection(Section):
    """``[audit]``: size of a file of the audit log, and how long earlier files are kept."""

    largest_mb: Annotated[float, Field(gt=0.0, le=1e6)] = 10.0
    keep_days: Positive = 365.0


class Certified(Section):
    """A certificate and its key (PEM); without them the service makes its own."""

    certificate_file: File | None = None
    key_file: File | None = None

    @model_validator(mode="after")
    def _whole(self) -> Certified:
        if (self.certificate_file is None) != (self.key_file is None):
            raise ValueError(
                "certificate_file and key_file belong together; give both, or neither for a "
                "certificate of the service's own"
            )
        return self


#: Companion specification of the service's own OPC UA server.
CompanionModel = Literal["none", "machinery", "machine-tool"]


class OpcuaServer(Certified):
    """``[opcua]``: the service's own OPC UA server."""

    address: str = "127.0.0.1"
    port: Port = 4840
    security: Literal["sign-and-encrypt", "none"] = "sign-and-encrypt"
    users: File | None = None
    trusted: File | None = None
    host_names: Texts = ()
    readings: bool = True
    companion: CompanionModel = "none"
    most_sessions: Annotated[int, Field(ge=1, le=1000)] = 20
    most_subscriptions: Annotated[int, Field(ge=1, le=10_000)] = 40
    most_items: Annotated[int, Field(ge=1, le=1_000_000)] = 20_000


class MqttTopics(MqttAddress):
    """``[mqtt]``: a retained topic for each machine."""

    topic: str = "thermojoint/{machine}/displacement"
    control_topic: str = "thermojoint/{machine}/control"
    heartbeat_topic: str = "thermojoint/service/heartbeat"
    status_topic: str = "thermojoint/service"


class HttpServer(Certified):
    """``[http]``: the dashboard, JSON and the stream."""

    address: str = "127.0.0.1"
    port: Port = 8443
    security: Literal["tls", "none"] = "tls"
    token: Secret | None = None
    host_names: Texts = ()
    session_hours: Annotated[float, Field(gt=0.0, le=8760.0)] = 168.0
    most_streams: Annotated[int, Field(ge=1, le=1000)] = 64
    most_per_address: Annotated[int, Field(ge=1, le=10_000)] = 128
    requests_per_s: Annotated[float, Field(gt=0.0, le=1e4)] = 20.0


class ShdrAdapter(Section):
    """``[shdr]``: an adapter for an MTConnect agent on this computer."""

    address: str = "127.0.0.1"
    port: Port = 7878
    heartbeat_s: Annotated[float, Field(ge=1.0, le=600.0)] = 10.0
    most_connections: Annotated[int, Field(ge=1, le=1000)] = 8


class ServiceFile(Section):
    """The whole file."""

    folder: File
    models: Annotated[dict[str, ModelSection], Field(min_length=1)]
    machines: Annotated[dict[str, MachineSection], Field(min_length=1)]
    sources: Annotated[dict[str, Source], Field(min_length=1)]
    ahead_s: Positive = 60.0
    behind_s: NotNegative = 60.0
    users: File | None = None
    watchdog: WatchdogSection = WatchdogSection()
    store: StoreSection = StoreSection()
    audit: AuditSection = AuditSection()
    opcua: OpcuaServer | None = None
    mqtt: MqttTopics | None = None
    http: HttpServer | None = None
    shdr: ShdrAdapter | None = None


@dataclass(frozen=True)
class Service:
    """A service as defined by its file."""

    given: ServiceFile
    #: Every single machine (``count`` expanded) by its name.
    machines: Mapping[str, MachineSection]

    @property
    def folder(self) -> Path:
        """Folder of the service's persistent data."""
        return self.given.folder

    @property
    def users_file(self) -> Path | None:
        """File of the users; earlier versions named it in ``[opcua]``."""
        return self.given.users or (self.given.opcua.users if self.given.opcua else None)


def read_service(path: Path | str) -> Service:
    """Read the file of a service.

    Raises
    ------
    InputError
        The file is missing or not TOML, a key is unknown or missing, a value is out of range, a
        name is unknown, or an address is open to others without protection.
    """
    data = toml.parse(toml.read_text(Path(path), "service"), str(path))
    return service_from_data(data, str(path), Path(path).parent)


def service_from_data(data: dict[str, Any], where: str, base: Path) -> Service:
    """Return a service given as nested dictionaries; raises as `read_service`."""
    given = settings_from(ServiceFile, data, where, base)
    for name, machine in given.machines.items():
        if not _NAME.fullmatch(name):
            raise InputError(
                f"{where}: machines.{name}: a name is up to 64 letters, digits, - and _; change it"
            )
        at = f"{where}: machines.{name}"
        if machine.model not in given.models:
            raise unknown_name("model", machine.model, given.models, at)
        if machine.source not in given.sources:
            raise unknown_name("source", machine.source, given.sources, at)
        _check_handshake(f"{at}.handshake", machine, given)
        _check_identification(f"{at}.identification", machine, given)
    singles = _single(given.machines)
    machines = dict(singles)
    if len(machines) < len(singles):
        ((twice, _),) = Counter(name for name, _ in singles).most_common(1)
        raise InputError(f"{where}: machines.{twice}: two sections give this machine; rename one")
    if len(machines) > MOST_MACHINES:
        raise InputError(
            f"{where}: {len(machines)} machines, of {MOST_MACHINES}; start a second service"
        )
    for name, source in given.sources.items():
        _check_pattern(f"{where}: sources.{name}", source, name, machines)
    _check_clients(where, given)
    _check_topics(f"{where}: mqtt", given, machines)
    _check_protected(where, given)
    return Service(given, machines)


def _check_handshake(at: str, machine: MachineSection, given: ServiceFile) -> None:
    """Refuse a handshake without offsets, or without the interface by which the control answers."""
    handshake = machine.handshake
    if (machine.target is not None) != (handshake is not None and handshake.by == "target"):
        raise InputError(f'{at}: by = "target" and the file of a target belong together; give both')
    if machine.target is not None and (machine.count or 1) > 1:
        raise InputError(f"{at}: a target is one control; give each machine its own section")
    if handshake is None:
        return
    if given.models[machine.model].offsets is None:
        raise InputError(
            f"{at}: models.{machine.model} sends no offsets; give it offsets, or leave this out"
        )
    if handshake.by == "target":
        if handshake.user is not None:
            raise InputError(
                f"{at}.user: is for OPC UA and HTTP; the file of a target names its own"
            )
        return
    if getattr(given, handshake.by) is None:
        raise InputError(f"{at}.by: there is no [{handshake.by}]; add it")
    if handshake.by == "opcua" and not (given.users or (given.opcua and given.opcua.users)):
        raise InputError(f"{at}.by: nobody may write; name a file of users")
    if handshake.by == "mqtt" and handshake.user is not None:
        raise InputError(f"{at}.user: is for OPC UA and HTTP; an MQTT broker says who may publish")


def _check_identification(at: str, machine: MachineSection, given: ServiceFile) -> None:
    """Refuse machines without an identification of their own if a specification needs it."""
    asked = given.opcua is not None and given.opcua.companion != "none"
    found = machine.identification
    if asked and found is None:
        raise InputError(f"{at}: missing; opcua.companion needs it")
    if found is None or machine.count is None:
        return
    for key in ("serial_number", "product_instance_uri"):
        if "{machine}" not in getattr(found, key):
            raise InputError(
                f"{at}.{key}: is for {machine.count} machines; write {{machine}} where they differ"
            )


def _single(sections: Mapping[str, MachineSection]) -> list[tuple[str, MachineSection]]:
    return [
        (kind, section)
        for name, section in sections.items()
        for kind in (
            [name] if section.count is None else [f"{name}-{k + 1}" for k in range(section.count)]
        )
    ]


def _check_pattern(
    where: str, source: Source, name: str, machines: Mapping[str, MachineSection]
) -> None:
    fed = [machine for machine, section in machines.items() if section.source == name]
    key = _LOCATING[source.kind]
    pattern = str(getattr(source, key))
    if len(fed) > 1 and "{machine}" not in pattern:
        raise InputError(
            f"{where}.{key}: feeds {len(fed)} machines; write {{machine}} in place of their names"
        )
    if isinstance(source, MqttSource):
        _check_topic(f"{where}.topic", pattern)
    if isinstance(source, OpcuaSource) and "{reading}" not in pattern:
        raise InputError(f"{where}.node: write {{reading}} in place of the name of a reading")
    if isinstance(source, MtconnectSource) and not _HTTP.fullmatch(source.url):
        raise InputError(f"{where}.url: {source.url!r} is none; give https://HOST:PORT")


def _check_topic(where: str, topic: str) -> None:
    """Refuse a topic that MQTT does not let a message have."""
    if not topic or set(topic) & set("+#"):
        raise InputError(
            f"{where}: {topic!r}: a topic has a name at every level, without + and #; write "
            "{machine} in place of the names of machines"
        )


def _check_clients(where: str, given: ServiceFile) -> None:
    """Refuse two clients of a broker with one name, and two readers of standard input."""
    fed = {machine.source for machine in given.machines.values()}
    known: dict[tuple[str, int, str], str] = {}
    piped = [
        name
        for name, source in given.sources.items()
        if name in fed and isinstance(source, CsvSource) and str(source.path) == "-"
    ]
    if len(piped) > 1:
        raise InputError(
            f"{where}: sources.{piped[1]}.path: sources.{piped[0]} reads standard input as well, "
            "and each would have some of its lines; give each its own file or FIFO"
        )
    for name, source in given.sources.items():
        if name not in fed or not isinstance(source, MqttSource):
            continue
        first = known.setdefault((source.host, source.port, source.client_id), name)
        if first != name:
            raise InputError(
                f"{where}: sources.{name}.client_id: sources.{first} has the same at this broker, "
                "which keeps one of the two; give each its own"
            )


def _check_topics(where: str, given: ServiceFile, machines: Mapping[str, MachineSection]) -> None:
    """Refuse a topic that is none, or that is for several machines or their controls."""
    if given.mqtt is None:
        return
    for key in ("topic", "control_topic", "heartbeat_topic", "status_topic"):
        _check_topic(f"{where}.{key}", getattr(given.mqtt, key))
    answering = [one for one in machines.values() if one.handshake and one.handshake.by == "mqtt"]
    for key, count in (("topic", len(machines)), ("control_topic", len(answering))):
        if count > 1 and "{machine}" not in getattr(given.mqtt, key):
            raise InputError(
                f"{where}.{key}: is for {count} machines; write {{machine}} in place of their names"
            )


def _check_protected(where: str, given: ServiceFile) -> None:
    """Refuse unprotected interfaces that other computers can reach."""
    for name, source in given.sources.items():
        if isinstance(source, MtconnectSource) and source.url.startswith("http:"):
            host = _host_in(source.url)
            if not is_loopback(host):
                raise InputError(
                    f"{where}: sources.{name}.url: http:// at {host}, which others reach; use "
                    "https://, or an agent or a proxy on 127.0.0.1"
                )
    if given.shdr and not is_loopback(given.shdr.address):
        raise InputError(
            f"{where}: shdr.address: {given.shdr.address}, which others reach: SHDR has no "
            "encryption; use 127.0.0.1 and an agent on this computer"
        )
    sources = {f"sources.{name}": source for name, source in given.sources.items()}
    outputs = {"mqtt": given.mqtt, "opcua": given.opcua, "http": given.http}
    for place, section in (sources | outputs).items():
        if isinstance(section, MqttAddress | OpcuaAddress | OpcuaServer | HttpServer):
            check_protected(f"{where}: {place}", section)


def check_protected(
    where: str, given: MqttAddress | OpcuaAddress | OpcuaServer | HttpServer
) -> None:
    """Refuse an unprotected server that other computers can reach."""
    if given.security != "none":
        return
    if isinstance(given, OpcuaAddress):
        host = _host_in(given.url)
    else:
        host = given.host if isinstance(given, MqttAddress) else given.address
    if not is_loopback(host):
        raise InputError(
            f'{where}: security = "none" at {host}, which others reach; use 127.0.0.1 or leave '
            "security as it is"
        )


def is_loopback(host: str) -> bool:
    """Return whether an address stays on this computer."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _host_in(url: str) -> str:
    match = re.match(r"[a-z.]+://(\[[^\]]*\]|[^:/]+)", url)
    return match[1] if match else url
