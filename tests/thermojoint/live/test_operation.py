"""What an administrator does to a service: check, reload, renew, roll back, back up."""

import asyncio
import contextlib
import gzip
import json
import shutil
import signal
import socket
import ssl
import stat
import tempfile
import time
import zlib
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import httpx
import pytest
from dashboard_server import BEARER, TOKEN
from live_parts import PATIENCE_S, events_in, free_port, until
from typer.testing import CliRunner

from thermojoint.artefacts.errors import InputError
from thermojoint.cli.app import app
from thermojoint.live import reloading
from thermojoint.live.backup import back_up, restore
from thermojoint.live.certificates import ANNOUNCED, HTTP_LASTS, expiry_warnings, own_certificate
from thermojoint.live.former_models import SHOWN, fingerprint_of, read_record
from thermojoint.live.reloading import serve_file
from thermojoint.live.service import checkpoint_store_log
from thermojoint.live.settings import HttpServer, read_service
from thermojoint.live.store import locked, send_sighup
from thermojoint.live.targets.settings import read_target
from thermojoint.live.users import add_user
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly

SERVICE = """
folder = "state"
users = "users"
[models.m]
file = "model.json"
interval_s = 1.0
[machines.mill]
model = "m"
source = "line"
[sources.line]
kind = "csv"
path = "log.csv"
[http]
port = {port}
token = {{ file = "token" }}
certificate_file = "plant.pem"
key_file = "plant.key"
requests_per_s = {rate}
"""
#: The control is reached with a certificate that is not there.
TARGET = """
kind = "beckhoff"
url = "opc.tcp://127.0.0.1"
axes = { Z = 1 }
server_certificate = "plc.der"
"""


@pytest.fixture(scope="module")
def models(hand_made_model, tmp_path_factory):
    """Two models, as files."""
    folder = tmp_path_factory.mktemp("models")
    linear = hand_made_model.linear
    other = replace(hand_made_model, linear=replace(linear, thermal=replace(linear.thermal, K=3.0)))
    for name, model in (("old", hand_made_model), ("new", other)):
        write_assembly(assemble(model, 1.0, 7200.0), folder / name)
    return {name: (folder / name).read_bytes() for name in ("old", "new")}


def plant(folder, models, port, rate=20.0):
    """The files of a service, with a certificate of the plant's."""
    own = own_certificate(folder / "made", HttpServer())
    (folder / "plant.pem").write_bytes(own.certificate.read_bytes())
    (folder / "plant.key").write_bytes(own.key.read_bytes())
    (folder / "plant.key").chmod(0o600)
    (folder / "model.json").write_bytes(models["old"])
    (folder / "token").touch(mode=0o600)
    (folder / "token").write_text(TOKEN)
    add_user(folder / "users", "eva", "engineer", "evas-secret")
    start = time.time() - 30.0
    rows = [f"{start + k:.1f},{20 + k / 10},20,20,20,20" for k in range(20)]
    header = "time_s,a_degC,b_degC,T1_degC,T2_degC,ambient_degC"
    (folder / "log.csv").write_text("\n".join([header, *rows]) + "\n")
    (folder / "service.toml").write_text(SERVICE.format(port=port, rate=rate))
    return folder / "service.toml"


def lead_to_a_control(file, target):
    """The machine gets offsets, which a file of a target writes into a control."""
    (file.parent / "offsets.toml").write_text('[axes.Z]\nfollows = "x"\n')
    written = file.read_text().replace('"model.json"', '"model.json"\noffsets = "offsets.toml"')
    section = f'[machines.mill]\ntarget = "{target}"\nhandshake = {{ by = "target" }}'
    file.write_text(written.replace("[machines.mill]", section))


def audit(folder):
    lines = (folder / "state" / "audit.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def called(*words, **given):
    return CliRunner().invoke(app, [str(word) for word in words], **given)


@contextlib.asynccontextmanager
async def running(file):
    """The service of a file; its starts so far, and what asks it to reload."""
    starts, stop, reload = [], asyncio.Event(), asyncio.Event()
    task = asyncio.create_task(serve_file(file, stop, reload, starts.append))
    try:
        await until(lambda: starts or task.done())
        yield starts, reload
    finally:
        stop.set()
        await task


@pytest.fixture(scope="module")
def life(models, tmp_path_factory):
    """A service through changes of its files, models and certificates; what came of it."""
    folder, port, found = tmp_path_factory.mktemp("plant"), free_port(), {}
    file = plant(folder, models, port)
    url = f"https://localhost:{port}"

    async def live():
        async with running(file) as (starts, reload):

            async def again():
                count = len(starts)
                reload.set()
                await until(lambda: len(starts) > count)

            def client():
                trusted = ssl.create_default_context(cafile=folder / "plant.pem")
                return httpx.AsyncClient(
                    base_url=url, verify=trusted, trust_env=False, timeout=PATIENCE_S
                )

            await until(lambda: starts[0].publisher.newest["mill"].number == 20)
            digests = [starts[-1].fleet.machines["mill"].model.digest]
            # A broken file and a broken model change nothing.
            (folder / "model.json").write_text("nonsense")
            reload.set()
            await asyncio.sleep(0.5)
            found["starts while broken"] = len(starts)
            async with client() as browser:
                found["serves"] = (await browser.get("/api/machines", headers=BEARER)).status_code
            # A new model, a renewed certificate and a changed setting.
            (folder / "model.json").write_bytes(models["new"])
            plant_renewed = own_certificate(folder / "renewed", HttpServer())
            (folder / "plant.pem").write_bytes(plant_renewed.certificate.read_bytes())
            (folder / "plant.key").write_bytes(plant_renewed.key.read_bytes())
            file.write_text(SERVICE.format(port=port, rate=30.0))
            await again()
            digests.append(starts[-1].fleet.machines["mill"].model.digest)
            async with client() as browser:
                answer = await browser.post("/machines/mill/rollback", headers=BEARER)
                found["viewer"] = answer.status_code
                await browser.post("/login", data={"name": "eva", "token": "evas-secret"})
                found["page"] = (await browser.get("/machines/mill")).text
                count = len(starts)
                answer = await browser.post("/machines/mill/rollback")
                found["engineer"] = answer.status_code
                await until(lambda: len(starts) > count)
            digests.append(starts[-1].fleet.machines["mill"].model.digest)
            # As the command does it.
            count = len(starts)
            asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, reload.set)
            assert send_sighup(folder / "state")
            await until(lambda: len(starts) > count)
            digests.append(starts[-1].fleet.machines["mill"].model.digest)
            # What is put into the file later counts again.
            (folder / "model.json").write_bytes(models["old"] + b"\n")
            await again()
            found["pins"] = read_record(folder / "state").pins
            found["digests"] = digests

    asyncio.run(live())
    found["audit"] = audit(folder)
    found["folder"], found["file"] = folder, file
    return found


def test_a_reload_that_would_fail_is_refused_and_the_service_goes_on(life):
    assert life["starts while broken"] == 1
    assert life["serves"] == 200


def test_changed_settings_and_models_are_audited(life):
    said = {(one["who"], one["what"]) for one in life["audit"]}
    assert ("service", "setting http.requests_per_s: 20.0 -> 30.0") in said
    changes = [one["what"] for one in life["audit"] if one["what"].startswith("model")]
    assert len(changes) == 4
    assert all(one["machine"] == "mill" for one in life["audit"] if one["what"] in changes)


def test_an_engineer_rolls_a_model_back_and_a_viewer_does_not(life):
    assert life["viewer"] == 403
    assert life["engineer"] == 303
    assert "Go back to model.json" in life["page"]
    old, new, back, after_reload = life["digests"]
    assert old == back == after_reload != new
    assert not life["pins"]
    rollbacks = [one for one in life["audit"] if "rollback" in one["what"]]
    assert [(one["who"], one["outcome"]) for one in rollbacks] == [
        ("http.token", "refused"),
        ("eva", "accepted"),
    ]


def test_a_rollback_by_command_holds_from_the_next_start(life, models):
    file = life["file"]
    listed = called("rollback", file, "mill", "--list").output.splitlines()
    assert len(listed) == 4
    for wrong in (("mil", "--list"), ("mill", "--list", "--to", "abc")):
        assert isinstance(called("rollback", file, *wrong).exception, InputError)
    new = next(line for line in listed if line.split()[0] != listed[0].split()[0])
    done = called("rollback", file, "mill", "--to", new.split()[0])
    assert "follows at its next start" in done.output
    assert called("rollback", file, "mill", "--to", "0" * SHOWN).exit_code != 0

    async def live():
        async with running(file) as (starts, _):
            return starts[0].service.given.models[starts[0].service.machines["mill"].model].file

    kept = asyncio.run(live())
    assert fingerprint_of(kept).startswith(new.split()[0])
    assert kept.read_bytes() == models["new"]


@pytest.mark.parametrize("wrong", ["users", "disk", "port", "folder"])
def test_a_reload_that_cannot_even_be_checked_ends_no_service(models, tmp_path, monkeypatch, wrong):
    file = plant(tmp_path, models, free_port())
    users = tmp_path / "users"

    async def live():
        async with running(file) as (starts, reload):
            if wrong == "port":
                taken = socket.create_server(("127.0.0.1", 0))
                closed_at_end.callback(taken.close)
                file.write_text(SERVICE.format(port=taken.getsockname()[1], rate=20.0))
            elif wrong == "folder":
                (tmp_path / "other").mkdir()
                closed_at_end.enter_context(locked(tmp_path / "other"))
                file.write_text(file.read_text().replace('folder = "state"', 'folder = "other"'))
            elif wrong == "users":
                users.write_bytes(users.read_bytes() + "# für die Halle\n".encode("cp1252"))
            else:
                monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
            reload.set()
            await asyncio.sleep(0.5)
            # It accepts who was accepted before.
            found = starts[0].accounts.by_password("eva", "evas-secret")
            return len(starts), starts[0].stop.is_set(), found.name

    with contextlib.ExitStack() as closed_at_end:
        assert asyncio.run(live()) == (1, False, "eva")


def test_a_reload_that_passes_its_check_and_does_not_start_leaves_the_former_service(
    models, tmp_path, monkeypatch
):
    """The address is taken between the check and the start."""
    file = plant(tmp_path, models, free_port())
    monkeypatch.setattr(reloading, "used_by_others", lambda service, present: [])

    async def live():
        async with running(file) as (starts, reload):
            for _ in range(2):
                count = len(starts)
                with socket.create_server(("127.0.0.1", 0)) as taken:
                    port = taken.getsockname()[1]
                    file.write_text(SERVICE.format(port=port, rate=20.0))
                    reload.set()
                    await until(lambda before=count: len(starts) > before)
            return [one.service.given.http.port for one in starts]

    ports = asyncio.run(live())
    assert len(ports) == 3
    assert len(set(ports)) == 1


def test_the_size_of_the_write_ahead_log_is_a_metric(models, tmp_path):
    async def live():
        async with running(plant(tmp_path, models, free_port())) as (starts, _):
            await checkpoint_store_log(starts[0])
            (sample,) = starts[0].metrics.log_size.collect()[0].samples
            return sample.value

    assert asyncio.run(live()) > 0.0


def test_check_says_all_that_a_start_would_refuse_and_leaves_the_folder_alone(models, tmp_path):
    file = plant(tmp_path, models, free_port())
    done = called("serve", file, "--check")
    assert done.exit_code == 0, done.output
    assert not (tmp_path / "state").exists()
    (tmp_path / "token").chmod(0o644)
    (tmp_path / "model.json").write_text("{}")
    (tmp_path / "plant.key").write_bytes((tmp_path / "made" / "http_certificate.pem").read_bytes())
    (tmp_path / "state").write_text("")
    done = called("serve", file, "--check")
    for said in ("http.token", "model.json", "plant.key", "nothing can be written in"):
        assert said in str(done.exception), said


def test_check_looks_at_the_way_to_a_control(models, tmp_path):
    file = plant(tmp_path, models, free_port())
    lead_to_a_control(file, "target.toml")
    (tmp_path / "target.toml").write_text(TARGET)
    assert "plc.der" in str(called("serve", file, "--check").exception)
    # With the usual heartbeat of 5 s.
    (tmp_path / "target.toml").write_text(f"every_s = 5.0\nlargest_step_um = 10.0\n{TARGET}")
    assert "no offset would follow" in str(called("serve", file, "--check").exception)


def test_a_backup_has_the_certificates_that_a_target_names(models, tmp_path):
    base, restored = tmp_path / "plant", tmp_path / "restored"
    (base / "plc").mkdir(parents=True)
    file = plant(base, models, free_port())
    lead_to_a_control(file, "plc/target.toml")
    (tmp_path / "plc.der").write_bytes(b"of the control")
    target = TARGET.replace("plc.der", "../../plc.der")
    (base / "plc" / "target.toml").write_text(f"largest_step_um = 10.0\n{target}")
    back_up(file, base / "b.tar.gz")
    (tmp_path / "plc.der").unlink()
    restore(base / "b.tar.gz", restored)
    machine = read_service(restored / "service.toml").machines["mill"]
    assert read_target(machine.target).server_certificate.read_bytes() == b"of the control"


def test_a_backup_that_is_damaged_anywhere_restores_nothing(models, tmp_path):
    archive, damaged = tmp_path / "b.tar.gz", tmp_path / "damaged.tar.gz"
    back_up(plant(tmp_path, models, free_port()), archive)
    content = archive.read_bytes()
    # From where the header of the .gz ends: its time and its name have no checksum.
    first = content.index(0, 10) + 1
    for k in [*range(first, len(content), len(content) // 64), *range(-8, 0)]:
        there = bytearray(content)
        there[k] ^= 0xFF
        with contextlib.suppress(OSError, EOFError, zlib.error):
            # The same zeros copied from another place: nothing is damaged.
            if gzip.decompress(there) == gzip.decompress(content):
                continue
        damaged.write_bytes(there)
        with pytest.raises(InputError, match="backup"):
            restore(damaged, tmp_path / "restored")
        assert not (tmp_path / "restored").exists()
    damaged.write_bytes(content[:-9])
    with pytest.raises(InputError, match="not a whole backup"):
        restore(damaged, tmp_path / "restored")


def test_the_end_of_a_certificate_is_announced_a_month_before(models, tmp_path):
    given = read_service(plant(tmp_path, models, 0)).given
    end = datetime.now(UTC) + HTTP_LASTS
    assert not list(expiry_warnings(given, tmp_path, end - ANNOUNCED - timedelta(days=1)))
    (line,) = expiry_warnings(given, tmp_path, end - timedelta(days=10))
    assert "plant.pem ends on" in line


def test_a_certificate_from_a_time_when_the_clock_was_ahead_is_announced(models, tmp_path):
    given = read_service(plant(tmp_path, models, 0)).given
    (line,) = expiry_warnings(given, tmp_path, datetime.now(UTC) - timedelta(days=1))
    assert "plant.pem is valid from" in line


def test_a_service_is_backed_up_while_it_runs_and_goes_on_where_it_is_restored(models, tmp_path):
    base = tmp_path / "plant"
    base.mkdir()
    port = free_port()
    file = plant(base, models, port)
    outside = tmp_path / "outside.json"
    outside.write_bytes(models["old"])
    file.write_text(file.read_text().replace('"model.json"', f'"{outside}"'))

    async def live():
        async with running(file) as (starts, _):
            await until(lambda: starts[0].publisher.newest["mill"].number == 20)
            digest = starts[0].fleet.machines["mill"].model.digest
            done = await asyncio.to_thread(called, "backup", file, "--out", base / "b.tar.gz")
            assert done.exit_code == 0, done.output
            return digest

    digest = asyncio.run(live())
    archive, restored = base / "b.tar.gz", tmp_path / "restored"
    assert stat.S_IMODE(archive.stat().st_mode) == 0o600
    done = called("restore", archive, "--out", restored)
    assert done.exit_code == 0, done.output
    assert not {"token", "plant.key"} & {path.name for path in restored.rglob("*")}
    outside.unlink()
    for name in ("token", "plant.key", "log.csv"):
        shutil.copy2(base / name, restored / name)

    async def again():
        async with running(restored / "service.toml") as (starts, _):
            mill = starts[0].fleet.machines["mill"]
            return mill.state.latest.number, mill.model.digest

    assert asyncio.run(again()) == (20, digest)
    assert not events_in(restored, "state-refused")
    # A backup takes the place of another one, and of nothing else.
    settings = file.read_text()
    assert called("backup", file, "--out", archive).exit_code == 0
    for taken in (file, base / "users"):
        assert "give another name" in str(called("backup", file, "--out", taken).exception)
    assert file.read_text() == settings
    # Nothing is overwritten.
    assert "not empty" in str(called("restore", archive, "--out", restored).exception)
