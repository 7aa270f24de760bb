"""Users, tokens, sessions and the audit log, through the real servers."""

import asyncio
import contextlib
import json
import os
import stat
import time
import types
from datetime import UTC, datetime, timedelta

import httpx
import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from dashboard_server import ABOUT, BEARER, TOKEN, again, event, keep, publication, serving
from live_parts import free_port, until
from small_disk import fill, mounted
from typer.testing import CliRunner

from thermojoint.cli.app import app
from thermojoint.live import opcua_internals
from thermojoint.live.access_store import open_access
from thermojoint.live.accounts import Accounts
from thermojoint.live.archive import Archive
from thermojoint.live.audit import Audit
from thermojoint.live.certificates import APPLICATION, own_identity
from thermojoint.live.log_lines import EventLog
from thermojoint.live.publisher import Publisher
from thermojoint.live.rate_limit import AT_ONCE
from thermojoint.live.settings import OpcuaServer
from thermojoint.live.tokens import add_token, revoke_token, tokens_in
from thermojoint.live.users import add_user, read_users, remove_user
from thermojoint.live.writers.opcua import ServerContext, open_server, serve_nodes

WEEK = 7 * 86400.0
SERVICE = """
folder = "state"
users = "users"
[models.m]
file = "m"
[machines.mill]
model = "m"
source = "s"
[sources.s]
kind = "csv"
path = "-"
"""


@pytest.fixture(scope="module")
def floor(tmp_path_factory):
    """A server with two machines, and users of one or both of them."""
    folder = tmp_path_factory.mktemp("access")
    add_user(folder / "users", "anna", "engineer", "annas-secret")
    add_user(folder / "users", "ben", "viewer", "bens-secret", ["mill-*"])
    now = time.time()
    runs = [[publication(k, now + k, name) for k in (1, 2)] for name in ("mill-1", "lathe-1")]
    machines = {"mill-1": ABOUT, "lathe-1": ABOUT}
    newest = [run[-1] for run in runs]
    said = [event("mill-1", "status", "T2 is missing")]
    said += [event("lathe-1", "status", f"T{k} is missing") for k in range(200)]
    said += [event(None, "ready", "2 machines")]
    archive = keep(folder / "store.db", runs, said)
    with serving(folder, archive, machines, newest) as found:
        found.folder = folder
        yield found


@pytest.fixture
def browser(floor):
    floor.forget_failures()
    with httpx.Client(base_url=floor.url, trust_env=False) as client:
        yield client


def bearer(token):
    return {"authorization": f"Bearer {token}"}


def test_logging_out_ends_the_session_on_the_server(floor, browser):
    assert browser.post("/login", data={"name": "anna", "token": "wrong"}).status_code == 401
    assert browser.post("/login", data={"name": "anna", "token": "annas-secret"}).status_code == 303
    (ticket,) = browser.cookies.items()
    stolen = {"cookie": "=".join(ticket)}
    assert httpx.get(f"{floor.url}/api/machines", headers=stolen).status_code == 200
    browser.post("/logout")
    assert httpx.get(f"{floor.url}/api/machines", headers=stolen).status_code == 401
    said = [(one["who"], one["what"], one["outcome"]) for one in floor.audit()[-3:]]
    assert said == [
        ("anna", "login", "refused"),
        ("anna", "login", "accepted"),
        ("anna", "logout", "accepted"),
    ]
    stored = b"".join(path.read_bytes() for path in floor.folder.glob("access.sqlite*"))
    assert ticket[1].encode() not in stored


def test_a_session_ends_with_its_user_or_password(floor, browser):
    add_user(floor.folder / "users", "carl", "viewer", "carls-secret")
    browser.post("/login", data={"name": "carl", "token": "carls-secret"})
    with browser.stream("GET", "/api/stream?every_s=0.1") as news:
        lines = news.iter_lines()
        assert next(lines)
        remove_user(floor.folder / "users", "carl")
        # It ends by itself; without that this would wait for an hour.
        floor.publish(again(floor.publisher.newest["mill-1"]))
        list(lines)
    assert browser.get("/api/machines").status_code == 401


def test_a_user_sees_the_machines_for_which_the_role_holds(floor, browser):
    browser.post("/login", data={"name": "ben", "token": "bens-secret"})
    seen = browser.get("/api/machines").json()["machines"]
    assert [one["machine"] for one in seen] == ["mill-1"]
    for path in ("/api/machines/lathe-1", "/api/machines/lathe-1/history", "/machines/lathe-1"):
        answer = browser.get(path)
        assert answer.status_code == 404
    assert browser.get("/api/events?machine=lathe-1").status_code == 400
    # However many there are of other machines, or of the service, after it.
    for asked in ("/api/events", "/api/events?most=1", "/api/events?machine=mill-1&most=1"):
        assert [one["text"] for one in browser.get(asked).json()["events"]] == ["T2 is missing"]
    assert browser.get("/metrics").status_code == 403
    with browser.stream("GET", "/api/stream?every_s=0.1") as news:
        told = next(line for line in news.iter_lines() if line.startswith("data: "))
    assert "mill-1" in told
    assert "lathe-1" not in told


def test_tokens_end_one_by_one(floor):
    store, now = floor.accounts.store, time.time()
    logger = add_token(store, "logger", "viewer", (now, now + WEEK))
    other = add_token(store, "other", "viewer", (now, now + WEEK), ["mill-1"])
    over = add_token(store, "over", "viewer", (now - WEEK, now - 1.0))
    url = f"{floor.url}/api/machines"
    status = [httpx.get(url, headers=bearer(one)).status_code for one in (logger, other, over)]
    assert status == [200, 200, 401]
    assert len(httpx.get(url, headers=bearer(other)).json()["machines"]) == 1
    used = {one.principal.name: one.used for one in tokens_in(store)}
    assert used["over"] is None
    assert used["logger"] >= now
    revoke_token(store, "logger")
    status = [httpx.get(url, headers=bearer(one)).status_code for one in (logger, other)]
    assert status == [401, 200]
    assert {("other", "token", "accepted"), ("", "token", "refused")} <= {
        (one["who"], one["what"], one["outcome"]) for one in floor.audit()
    }
    floor.forget_failures()


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"host": "evil.example"}, 421),
        ({"host": "localhost:1"}, 401),
        ({"host": "["}, 421),
        ({"origin": "https://evil.example"}, 403),
        ({"origin": "null"}, 403),
    ],
)
def test_requests_for_other_names_and_from_other_pages_are_refused(floor, headers, status):
    assert httpx.get(f"{floor.url}/api/machines", headers=headers).status_code == status
    if status == 403:
        answer = httpx.post(f"{floor.url}/login", data={"token": TOKEN}, headers=headers)
        assert answer.status_code == 403
        assert httpx.get(f"{floor.url}/api/stream", headers=headers | BEARER).status_code == 403


def test_pages_of_the_service_itself_may_log_in(floor, browser):
    headers = {"origin": floor.url}
    assert browser.post("/login", data={"token": TOKEN}, headers=headers).status_code == 303


def test_an_audit_log_that_cannot_be_written_lets_nobody_in(floor, browser, monkeypatch):
    monkeypatch.setattr(floor.accounts.audit, "path", floor.folder / "no" / "folder")
    assert browser.post("/login", data={"token": TOKEN}).status_code == 503


def test_the_audit_log_rotates_and_refusals_do_not_fill_it(tmp_path):
    audit = Audit(tmp_path / "audit.jsonl", largest=1000, keep=3600.0)
    for _ in range(100):
        audit.refused("guest", "http 192.0.2.7", "login", "wrong")
    assert len(audit.path.read_text().splitlines()) == AT_ONCE
    for k in range(20):
        audit.accepted("anna", "http 192.0.2.7", f"write {k}", "mill-1")
    files = sorted(tmp_path.glob("audit*.jsonl"))
    assert len(files) > 1
    assert max(path.stat().st_size for path in files) <= 1000
    lines = [json.loads(line) for path in files for line in path.read_text().splitlines()]
    assert {f"write {k}" for k in range(20)} <= {one["what"] for one in lines}


def test_on_a_full_disk_people_and_controls_come_in_and_the_audit_log_has_them_later(
    tmp_path, monkeypatch
):
    with mounted(tmp_path / "disk", 4) as disk:
        audit = Audit(disk / "audit.jsonl")
        audit.accepted("anna", "http 192.0.2.7", "before")
        filler = fill(disk)
        # The last block has room for a part of a line.
        for k in range(40):
            audit.accepted("anna", "http 192.0.2.7", f"login {k}")
            audit.written("plc", "opcua 192.0.2.7", "write mill.Control.Heartbeat", "mill")
        with pytest.raises(OSError, match="No space"):
            audit.accepted("anna", "http 192.0.2.7", 2_000_000 * "x")
        filler.unlink()
        audit.accepted("anna", "http 192.0.2.7", "after")
        later = types.SimpleNamespace(time=time.time, monotonic=lambda: time.monotonic() + 100.0)
        monkeypatch.setattr("thermojoint.live.audit.time", later)
        audit.written("plc", "opcua 192.0.2.7", "write mill.Control.Heartbeat", "mill")
        lines = [json.loads(line) for line in audit.path.read_text().splitlines()]
    said = [one["what"] for one in lines if one["who"] == "anna"]
    assert said == ["before", *(f"login {k}" for k in range(40)), "after"]
    writes = [one for one in lines if one["who"] == "plc"]
    assert len(writes) + sum(one.get("left_out_before", 0) for one in writes) == 41


@pytest.mark.skipif(os.geteuid() != 0, reason="root alone can give files away")
def test_what_a_command_of_root_writes_belongs_to_the_services_user(tmp_path):
    os.chown(tmp_path, 65534, 65534)
    open_access(tmp_path).close()
    Audit(tmp_path / "audit.jsonl").accepted("root", "command", "token x")
    add_user(tmp_path / "users", "panel", "viewer", "panel-secret")
    for name in ("access.sqlite", "audit.jsonl", "users"):
        about = (tmp_path / name).stat()
        assert (about.st_uid, stat.S_IMODE(about.st_mode)) == (65534, 0o600), name


def test_a_value_that_is_written_in_every_cycle_is_audited_with_its_count(tmp_path):
    audit = Audit(tmp_path / "audit.jsonl")
    for _ in range(1000):
        audit.written("plc", "opcua 192.0.2.7", "write mill.Control.heartbeat", "mill")
    assert len(audit.path.read_text().splitlines()) == AT_ONCE
    # Another value each time is the same node.
    for k in range(1000):
        audit.written("service", "opc.tcp://192.0.2.7", "write ns=2;s=Z", "mill", f" = {k}")
    lines = [json.loads(line)["what"] for line in audit.path.read_text().splitlines()[AT_ONCE:]]
    assert lines == [f"write ns=2;s=Z = {k}" for k in range(AT_ONCE)]


@pytest.fixture
def called(tmp_path):
    """Run a command on the file of a service."""
    (tmp_path / "service.toml").write_text(SERVICE)

    def run(command, *more, **given):
        return CliRunner().invoke(app, [command, str(tmp_path / "service.toml"), *more], **given)

    return run


def test_the_commands_list_make_and_end_users_and_tokens(called, tmp_path):
    def said(*words, **given):
        done = called(*words, **given)
        assert done.exit_code == 0, done.output
        return done.output

    said("users", "--add", "anna", "--role", "operator", "--machines", "a,b", input="anna-pass\n")
    assert read_users(tmp_path / "users")["anna"].machines == ("a", "b")
    assert "operator" in said("users")
    before = read_users(tmp_path / "users")["anna"]
    said("users", "--add", "anna", input="another-pass\n")
    after = read_users(tmp_path / "users")["anna"]
    assert (after.role, after.machines) == ("operator", ("a", "b"))
    assert after.password != before.password
    said("users", "--remove", "anna")
    assert "anna" not in said("users")
    secret = said("tokens", "--add", "logger", "--days", "90").strip()
    listed = said("tokens")
    assert "logger" in listed
    assert secret not in listed
    said("tokens", "--revoke", "logger")
    assert said("tokens") == ""
    lines = (tmp_path / "state" / "audit.jsonl").read_text().splitlines()
    assert len(lines) == 5
    assert secret not in "".join(lines)


@pytest.mark.parametrize(
    ("command", "option", "value"),
    [
        ("users", "--role", "engineer"),
        ("users", "--machines", "mill-*"),
        ("tokens", "--role", "engineer"),
        ("tokens", "--machines", "mill-*"),
        ("tokens", "--days", "30"),
    ],
)
def test_rights_without_anybody_who_gets_them_are_refused(called, command, option, value):
    done = called(command, option, value)
    assert str(done.exception) == f"{option}: goes with --add; leave it out"


@pytest.mark.parametrize("days", ["1e9", "inf"])
def test_a_token_that_no_calendar_has_the_end_of_is_refused(called, days):
    done = called("tokens", "--add", "logger", "--days", days)
    assert "--days" in str(done.exception)
    listed = called("tokens")
    assert (listed.exit_code, listed.output) == (0, "")


# OPC UA


def issued(folder, name, days=(-1, 1), authority=None):
    """A client's certificate and key, of an authority or signed by itself."""
    own = own_identity(folder / name, ())
    key = serialization.load_pem_private_key(own.key.read_bytes(), None)
    ca, ca_key = authority or (None, key)
    now = datetime.now(UTC)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(ca.subject if ca else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now + timedelta(days=days[0]))
        .not_valid_after(now + timedelta(days=days[1]))
        .add_extension(
            x509.SubjectAlternativeName([x509.UniformResourceIdentifier(APPLICATION)]), False
        )
        .add_extension(x509.BasicConstraints(ca=name == "authority", path_length=None), True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH]), False)
        .sign(ca_key, hashes.SHA256())
    )
    own.certificate.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    return own, made, key


async def logged_in(port, server, own, user):
    client = Client(f"opc.tcp://127.0.0.1:{port}/thermojoint")
    client.application_uri = APPLICATION
    await client.set_security(
        SecurityPolicyBasic256Sha256, own.certificate, own.key, server_certificate=str(server)
    )
    client.set_user(user)
    client.set_password(f"{user}-secret")
    return client


async def lets_in(*given):
    with contextlib.suppress(ua.UaError):
        async with await logged_in(*given):
            return True
    return False


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    """An OPC UA server with two machines and a trust list; what its clients found."""
    folder = tmp_path_factory.mktemp("plant")
    for name, role, machines in (
        ("viewer", "viewer", "*"),
        ("setter", "operator", "mill-1"),
        ("leaver", "operator", "*"),
        ("guest", "viewer", "*"),
    ):
        add_user(folder / "users", name, role, f"{name}-secret", [machines])
    trusted = folder / "trusted"
    trusted.mkdir()
    panel = issued(folder, "panel")[0]
    (trusted / "panel.pem").write_bytes(panel.certificate.read_bytes())
    unknown = issued(folder, "unknown")[0]
    expired = issued(folder, "expired", (-2, -1))[0]
    early = issued(folder, "early", (1, 2))[0]
    for one in (expired, early):
        (trusted / f"{one.certificate.parent.name}.pem").write_bytes(one.certificate.read_bytes())
    _, ca, ca_key = issued(folder, "authority")
    (trusted / "ca.pem").write_bytes(ca.public_bytes(serialization.Encoding.PEM))
    of_authority, listed, _ = issued(folder, "employee", authority=(ca, ca_key))

    port, publisher, given, found = free_port(), Publisher(), [], {}
    publisher.publish([publication(1, time.time(), name) for name in ("mill-1", "lathe-1")])
    audit = Audit(folder / "audit.jsonl")
    accounts = Accounts(open_access(folder), audit, folder / "users")
    # The server's certificate is the authority's, too.
    own, _, _ = issued(folder, "server", authority=(ca, ca_key))
    section = OpcuaServer(
        port=port,
        users=folder / "users",
        trusted=trusted,
        certificate_file=own.certificate,
        key_file=own.key,
    )
    server_certificate = own.certificate

    async def live():
        machines = dict.fromkeys(("mill-1", "lathe-1"), (ABOUT.layout, 1))
        context = ServerContext(
            accounts, folder, EventLog(), {}, Archive(folder / "history.sqlite")
        )
        server, nodes = await open_server(section, context, publisher, machines, given.append, {})
        serving = asyncio.create_task(serve_nodes(server, nodes, publisher))
        at = (port, server_certificate)
        clients = {"panel": panel, "unknown": unknown, "expired": expired, "early": early}
        found["in"] = {name: await lets_in(*at, own, "viewer") for name, own in clients.items()}
        found["rejected"] = list((folder / "rejected").iterdir())
        found["rejected"][0].rename(trusted / "moved.der")
        found["moved"] = await lets_in(*at, unknown, "viewer")
        found["issued"] = await lets_in(*at, of_authority, "viewer")
        now = datetime.now(UTC)
        crl = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(ca.subject)
            .last_update(now)
            .next_update(now + timedelta(days=1))
            .add_revoked_certificate(
                x509.RevokedCertificateBuilder()
                .serial_number(listed.serial_number)
                .revocation_date(now)
                .build()
            )
            .sign(ca_key, hashes.SHA256())
        )
        (trusted / "ca.crl").write_bytes(crl.public_bytes(serialization.Encoding.PEM))
        found["revoked"] = await lets_in(*at, of_authority, "viewer")
        with pytest.MonkeyPatch.context() as patch, contextlib.suppress(Exception):
            patch.setattr(opcua_internals, "CHECKED_S", 0.1)
            async with await logged_in(*at, panel, "guest") as client:
                node = client.get_node("ns=2;s=mill-1.Displacement.x")
                await node.read_value()
                found["guest"] = "reads"
                remove_user(folder / "users", "guest")
                await until(lambda: not server.bserver.clients)
                found["guest"] = "disconnected"
                # From now on the writes below come before the next look at the accounts.
                patch.setattr(opcua_internals, "CHECKED_S", 60.0)
                await asyncio.sleep(0.5)
        value = ua.DataValue(ua.Variant(7.0, ua.VariantType.Double))

        async def tries(user, machine, name="T2_degC"):
            async with await logged_in(*at, panel, user) as client:
                node = client.get_node(f"ns=2;s={machine}.Probe.{name}")
                if user == "leaver":
                    remove_user(folder / "users", "leaver")
                try:
                    await node.write_value(value)
                except ua.UaError as error:
                    return type(error).__name__
            return "written"

        pairs = [("viewer", "mill-1"), ("setter", "mill-1"), ("setter", "lathe-1")]
        pairs += [("leaver", "mill-1"), ("setter", "mill-1", "T99_degC")]
        found["write"] = {pair: await tries(*pair) for pair in pairs}
        async with await logged_in(*at, panel, "setter") as client:
            for machine in ("mill-1", "lathe-1"):
                node = client.get_node(f"ns=2;s={machine}.Displacement.x")
                read = await node.read_data_value(raise_on_bad_status=False)
                found["read", machine] = read.StatusCode.name
            tree = await client.get_node("ns=2;s=Machines").get_children()
            found["browsed"] = [one.nodeid.Identifier for one in tree]
            path = ["2:Machines", "2:lathe-1"]
            with contextlib.suppress(ua.UaStatusCodeError):
                found["translated"] = await client.nodes.objects.get_child(path)
            node = client.get_node("ns=2;s=lathe-1.Displacement")
            found["children"] = await node.get_children()
            (unit,) = await client.get_node("ns=2;s=mill-1.Displacement.x").get_properties()
            found["unit"] = (await unit.read_value()).DisplayName.Text
            node = client.get_node("ns=2;s=lathe-1.Displacement.x")
            subscription = await client.create_subscription(100.0, None)
            with contextlib.suppress(ua.UaError):
                await subscription.subscribe_data_change(node)
                found["subscribed"] = True
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)

    asyncio.run(live())
    found["audit"] = [json.loads(line) for line in audit.path.read_text().splitlines()]
    found["given"] = given
    return found


def test_only_trusted_certificates_that_are_valid_now_are_let_in(plant):
    assert plant["in"] == {"panel": True, "unknown": False, "expired": False, "early": False}
    assert len(plant["rejected"]) == 1
    assert plant["moved"]
    why = {one["why"] for one in plant["audit"] if one["outcome"] == "refused"}
    assert "the certificate is not trusted" in why
    assert any("valid from" in one for one in why)


def test_certificates_of_an_authority_are_let_in_until_it_revokes_them(plant):
    assert plant["issued"]
    assert not plant["revoked"]


def test_writing_by_opcua_needs_the_role_on_this_machine_and_is_audited(plant):
    denied = "BadUserAccessDenied"
    assert plant["write"] == {
        ("viewer", "mill-1"): denied,
        ("setter", "mill-1"): "written",
        ("setter", "lathe-1"): denied,
        ("leaver", "mill-1"): denied,
        ("setter", "mill-1", "T99_degC"): denied,
    }
    assert [(one.machine, one.readings) for one in plant["given"]] == [("mill-1", [None, 7.0])]
    writes = [one for one in plant["audit"] if one["what"].startswith("write")]
    assert [(one["who"], one["machine"], one["outcome"]) for one in writes] == [
        ("viewer", "mill-1", "refused"),
        ("setter", "mill-1", "accepted"),
        ("setter", "lathe-1", "refused"),
        ("leaver", "mill-1", "refused"),
        # Of a machine on which he may write, but there is no such variable.
        ("setter", "mill-1", "refused"),
    ]
    assert {one["from"] for one in plant["audit"]} == {"opcua 127.0.0.1"}


def test_a_removed_user_is_disconnected_from_opcua(plant):
    assert plant["guest"] == "disconnected"


def test_values_of_other_machines_are_not_read_by_opcua(plant):
    assert plant["read", "mill-1"] == "Good"
    assert plant["read", "lathe-1"] == "BadUserAccessDenied"
    assert "subscribed" not in plant


def test_other_machines_cannot_be_browsed_by_opcua(plant):
    assert [name for name in plant["browsed"] if name != "Heartbeat"] == ["mill-1"]
    assert "translated" not in plant
    assert plant["children"] == []
    # What machines share stays readable.
    assert plant["unit"] == "µm"
