"""The pages that set up: who gets in, what is refused, what a form does to a file."""

import errno
import os
import re
import signal
import stat
import subprocess
import time
import tomllib

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_parts import PATIENCE_S, free_port
from machine_logs import as_csv, machine_log
from own_process import OwnProcess
from reference_case import lasting
from starlette.testclient import TestClient

from calibrate.learning.learn import learn
from thermojoint.models.learned import write_learned
from thermojoint.setup_pages import jobs
from thermojoint.setup_pages.app import PAGES, make_app
from thermojoint.setup_pages.gate import Key
from thermojoint.setup_pages.jobs import Jobs, Record
from thermojoint.setup_pages.place import Place
from thermojoint.setup_pages.toml_form import changed, fields_of
from thermojoint.setup_pages.uploads import LARGEST_PIECE

HERE = "http://127.0.0.1:8123"
#: The offsets of one axis, as a person would write them.
OFFSETS = """\
# Agreed with the operator.
rate_um_s = 1.0  # fastest change
# widest_band_um = 50.0 # and so does a wider band

[axes.Z]  # of the control
follows = "x"
sign = -1 # one of: -1, 1
"""
ESTIMATE = "time_s,x_um,x_band_um,status,quality\n0,0,1,ok,good\n1,5,1,ok,good\n"
FOLLOWED = {"offsets.toml": OFFSETS, "estimate.csv": ESTIMATE}
TARGET = 'kind = "beckhoff"\nurl = "opc.tcp://127.0.0.1"\nsecurity = "none"\naxes = { Z = 1 }\n'
SERVICE = """\
folder = "state"
models = { m = { file = "model.json", offsets = "offsets.toml" } }
sources = { line = { kind = "csv", path = "mill.csv" } }
[machines.mill]
model = "m"
source = "line"
target = "target.toml"
handshake = { by = "target" }
"""


FACES = """\
[bodies_mm]
bed = [0.0, 1.0, 2.0]
block = [9.0, 9.0, 9.0]
[joints]
bed_block = ["bed", "block"]
[surfaces_mm]
face_1 = [[0.0, 1.0, 2.0]] # bed, 8 cm2
face_2 = [[3.0, 4.0, 5.0]] # bed, 8 cm2
"""


@pytest.fixture
def place(tmp_path):
    made = Place(tmp_path, Jobs(tmp_path))
    yield made
    made.jobs.close()


@pytest.fixture
def key():
    return Key(frozenset({"127.0.0.1"}), 8123)


@pytest.fixture
def stranger(place, key):
    """A client that has opened no link."""
    return TestClient(make_app(place, key), HERE, headers={"origin": HERE}, follow_redirects=False)


@pytest.fixture
def client(stranger, key):
    stranger.get("/", params={"token": key.token})
    return stranger


def ended(place):
    """Wait for the end of what runs."""
    end = time.monotonic() + PATIENCE_S
    while place.jobs.running:
        assert time.monotonic() < end
        time.sleep(0.05)


def put(place, texts):
    """Write files by name."""
    for name, text in texts.items():
        (place.folder / name).write_text(text)


def recorded(place, step, *lines):
    """Put a run of a step on record."""
    place.jobs.records.mkdir(exist_ok=True)
    (place.jobs.records / f"{step}.log").write_text("\n".join([*lines, ""]))


def sent(client, page, **values):
    """Send a form; the status and the page."""
    answer = client.post(page, data=values)
    return answer.status_code, answer.text


def form(client, page, file, **values):
    """Send the form of a file of settings as it is, with some values changed."""
    text = client.get(page).text
    digest = text.split(f'name="file" value="{file}"')[1].split('name="digest" value="')[1]
    return sent(client, page, file=file, digest=digest.split('"')[0], **values)


# Who gets in


def test_a_link_is_good_for_one_browser(stranger, key, capsys):
    token = key.token
    assert stranger.get("/").status_code == 401
    assert stranger.get("/", params={"token": "wrong"}).status_code == 401
    answer = stranger.get("/", params={"token": token})
    assert answer.status_code == 303
    assert "HttpOnly" in answer.headers["set-cookie"]
    assert "SameSite=strict" in answer.headers["set-cookie"]
    assert stranger.get("/").status_code == 200
    stranger.cookies.clear()
    assert stranger.get("/", params={"token": token}).status_code == 401
    assert key.link in capsys.readouterr().out


def test_the_command_serves_a_folder_until_ctrl_c(tmp_path, command):
    assert command("setup", tmp_path / "none")[0] == 2
    folder = tmp_path / "folder"
    folder.mkdir()
    with (tmp_path / "said.txt").open("w") as said:
        process = OwnProcess("setup", folder, stdout=said)
    try:
        end = time.monotonic() + PATIENCE_S
        while not (said := (tmp_path / "said.txt").read_text()).endswith("\n"):
            assert time.monotonic() < end
            time.sleep(0.05)
        link = said.split()[1]
        with httpx.Client(follow_redirects=True, trust_env=False) as browser:
            assert browser.get(link.partition("?")[0]).status_code == 401
            assert str(folder) in browser.get(link).text
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"host": "evil.example"}, 421),
        ({"x": "y" * 20_000}, 431),
    ],
)
def test_pages_of_others_and_other_names_are_refused(client, headers, status):
    assert client.post("/log", data={"log": "a.csv"}, headers=headers).status_code == status


def test_a_form_without_an_origin_is_refused(client):
    client.headers.pop("origin")
    assert client.post("/log", data={"log": "a.csv"}).status_code == 403


def test_a_form_is_bounded(client):
    assert client.post("/log", content=b"a" * ((1 << 20) + 1)).status_code == 413


def test_a_page_runs_no_script_but_its_own_files(client):
    answer = client.get("/")
    assert "script-src 'self'" in answer.headers["content-security-policy"]
    assert "<script>" not in answer.text
    addresses = re.findall(r"/assets/[^\"]+", answer.text)
    assert addresses
    assert all(client.get(address).status_code == 200 for address in addresses)


# Files


@pytest.mark.parametrize("name", ["..%2Fsecret.csv", ".hidden.csv", "-o.csv", "a%2Fb.csv"])
def test_no_file_outside_of_the_folder_is_read_or_written(name, client, place):
    (place.folder.parent / "secret.csv").write_text("secret")
    assert client.get(f"/files/{name}").status_code in (400, 404)
    assert client.post(f"/upload/{name}?at=0&size=1", content=b"x").status_code in (400, 404)


def test_a_link_out_of_the_folder_is_none_of_its_files(client, place):
    (place.folder.parent / "secret.txt").write_text("secret")
    (place.folder / "own.txt").symlink_to(place.folder.parent / "secret.txt")
    assert client.get("/files/own.txt").status_code == 400


def test_secrets_are_neither_listed_nor_handed_out(client, place):
    for name in ("control-password", "dashboard.token"):
        (place.folder / name).write_text("secret")
        assert client.get(f"/files/{name}").status_code == 404
        assert name not in client.get("/").text


def upload(client, name, content, piece=LARGEST_PIECE):
    for at in range(0, len(content), piece):
        where = f"/upload/{name}?at={at}&size={len(content)}"
        answer = client.post(where, content=content[at : at + piece])
    return answer


def test_a_file_is_sent_in_pieces_and_replaces_none(client, place):
    content = bytes(range(256)) * 10
    assert upload(client, "a.csv", content, 1000).status_code == 204
    assert (place.folder / "a.csv").read_bytes() == content
    answer = upload(client, "a.csv", b"other")
    assert answer.status_code == 400
    assert "exists" in answer.json()["error"]
    assert (place.folder / "a.csv").read_bytes() == content


def test_a_file_is_sent_where_there_are_no_hard_links(client, place, monkeypatch):
    """As to exFAT, or over SMB."""

    def link(*_, **__):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", link)
    assert upload(client, "a.csv", b"0123456789", 4).status_code == 204
    assert (place.folder / "a.csv").read_bytes() == b"0123456789"
    assert not list(place.jobs.records.glob("upload-*"))


@pytest.mark.parametrize("linked", [False, True])
def test_a_file_that_came_while_another_was_sent_stays(client, place, monkeypatch, linked):
    made = os.link

    def link(*given, **more):
        (place.folder / "a.csv").write_bytes(b"mine")
        if not linked:
            raise OSError(errno.ENOTSUP, "Operation not supported")
        made(*given, **more)

    monkeypatch.setattr(os, "link", link)
    answer = upload(client, "a.csv", b"other")
    assert answer.status_code == 400
    assert answer.json()["error"] == "a.csv: exists already; send it under another name"
    assert (place.folder / "a.csv").read_bytes() == b"mine"


def test_what_the_disk_refuses_is_said_in_one_line(client, place):
    place.jobs.records.write_text("no folder")
    answer = upload(client, "a.csv", b"other")
    assert answer.status_code == 400
    assert "a.csv: cannot be written (File exists)" in answer.json()["error"]


@pytest.mark.parametrize(
    ("name", "at", "size", "told"),
    [
        ("run.sh", 0, 1, "not used"),
        ("\u6e29" * 100 + ".csv", 0, 1, "not the name of a file"),
        ("a.csv", 0, 1 << 40, "larger"),
        ("a.csv", 5, 9, "missing"),
        ("a.csv", -1, 9, "larger"),
    ],
)
def test_what_is_no_piece_of_a_file_is_refused(name, at, size, told, client, place):
    answer = client.post(f"/upload/{name}?at={at}&size={size}", content=b"x")
    assert answer.status_code == 400
    assert told in answer.json()["error"]
    assert not place.tables()


def test_a_piece_that_is_too_large_is_refused(client):
    content = b"x" * (LARGEST_PIECE + 1)
    assert client.post("/upload/a.csv?at=0&size=9999999", content=content).status_code == 413


# Steps


def test_columns_are_named_in_a_file_and_others_are_not_overwritten(client, place):
    as_csv(machine_log(hours=1.0), place.folder / "log.csv")
    text = (place.folder / "log.csv").read_text().replace("T1_degC", "Fühler")
    (place.folder / "log.csv").write_text(text)
    (place.folder / "log.png").write_bytes(b"mine")
    assert "log.png: exists already" in sent(client, "/log", log="log.csv")[1]
    (place.folder / "log.png").unlink()
    recorded(place, "log", "$ thermojoint look log.csv --out=log.png", "exit code 0")
    status, page = sent(client, "/log", **{"name:Fühler": "T1"})
    assert status == 400
    assert "ends in no unit" in page
    assert sent(client, "/log", **{"name:Fühler": "T1_degC"})[0] == 303
    ended(place)
    assert tomllib.loads(place.text("columns.toml")) == {"columns": {"Fühler": "T1_degC"}}
    assert place.is_done("log")
    assert "ignored" not in place.record("log").output
    (place.folder / "columns.toml").write_text("# mine\n[columns]\n'Fühler' = 'T1_degC'\n")
    assert "columns.toml: exists" in sent(client, "/log", **{"name:Fühler": "T9_degC"})[1]
    assert not place.is_done("log")


def test_where_an_axis_stands_is_no_displacement_to_learn(client, place):
    """It was ticked, as every length."""
    (place.folder / "log.csv").write_text("time_s,T1_degC,x_um,y_pos_mm\n0,20,1,-300\n60,21,2,0\n")
    recorded(place, "log", "$ thermojoint look log.csv --out=log.png", "exit code 0")
    page = client.get("/learn").text
    assert 'value="x_um"' in page
    assert 'value="y_pos_mm"' not in page


def test_a_command_that_fails_says_why_and_one_that_runs_can_be_cancelled(client, place):
    (place.folder / "log.csv").write_text("a,b\n1,2\n")
    sent(client, "/log", log="log.csv")
    ended(place)
    assert "no clock" in client.get("/log").text
    assert place.record("log").code == 2
    # It waits for its standard input's end, or for ever.
    place.jobs.start("log", ["serve", "missing.toml"], ["verify"])
    place.jobs.cancel()
    ended(place)
    assert "cancelled" in place.record("log").output
    assert place.record("log").code != 0


def test_a_mistake_in_a_setting_stands_beside_its_field(client, place):
    put(place, FOLLOWED)
    status, page = form(client, "/offsets", "offsets.toml", rate_um_s="fast")
    assert status == 400
    beside = page.split('name="rate_um_s" value="fast"')[1].split("</div>")[0]
    assert "input should be a valid number" in beside
    assert place.text("offsets.toml") == OFFSETS
    assert form(client, "/offsets", "offsets.toml", rate_um_s="2.5")[0] == 303
    assert place.text("offsets.toml") == OFFSETS.replace("1.0", "2.5", 1)


def test_an_axis_of_the_control_compensates_one_displacement(client, place):
    table = "time_s,x_um,y_um,x_band_um,y_band_um,status,quality\n0,0,0,1,1,ok,good\n"
    put(place, {"estimate.csv": table})
    both = {"begin": "yes", "axis:x": "Z", "axis:y": "Z"}
    status, page = sent(client, "/offsets", **both)
    assert status == 400
    assert "Z would compensate both x and y" in page
    assert not place.has("offsets.toml")
    assert sent(client, "/offsets", **both | {"axis:y": "Y"})[0] == 303
    assert "[axes.Y]" in place.text("offsets.toml")


def test_a_form_is_not_loaded_again_while_another_step_runs(client, place):
    """What somebody typed into it was lost each second."""
    place.jobs.start("learn", ["verify"])
    found = {step: "http-equiv" in client.get(f"/{step}").text for step in ("learn", "log", "")}
    place.jobs.cancel()
    assert found == {"learn": True, "log": False, "": False}
    ended(place)


def test_a_value_that_is_none_of_its_choices_stays(client, place):
    """Saved with the form as it stood, it was left out."""
    text = OFFSETS.replace('follows = "x"', 'follows = "x_at_-100" # one of: x, z')
    text = 'unusable = ["silent"] # one of: unsettled, refused\n' + text
    put(place, FOLLOWED | {"offsets.toml": text})
    page = client.get("/offsets").text
    assert '<option value="x_at_-100" selected>' in page
    assert 'value="silent" checked>' in page


def test_a_form_of_a_file_that_has_changed_since_is_refused(client, place):
    put(place, FOLLOWED)
    status, page = sent(client, "/offsets", file="offsets.toml", digest="old", rate_um_s="2")
    assert status == 400
    assert "has changed since" in page


@pytest.mark.parametrize(
    ("page", "name"),
    [("/offsets", "offsets.toml"), ("/control", "service.toml"), ("/names", "faces.toml")],
)
@pytest.mark.parametrize(
    ("mistake", "told"), [(b"[[[", "no valid TOML"), ("# f\u00fcr".encode("cp1252"), "in UTF-8")]
)
def test_a_file_that_is_no_toml_is_told_on_its_page(page, name, mistake, told, client, place):
    put(place, FOLLOWED)
    (place.folder / name).write_bytes(mistake)
    answer = client.get(page)
    assert answer.status_code == 400
    assert re.search(f"{name}: .*{told}", answer.text)


def test_a_form_of_a_file_with_a_byte_order_mark_is_saved(client, place):
    put(place, FOLLOWED)
    path = place.folder / "offsets.toml"
    path.write_text(OFFSETS, "utf-8-sig")
    assert form(client, "/offsets", "offsets.toml", rate_um_s="2.0")[0] == 303
    ended(place)
    assert path.read_text("utf-8") == OFFSETS.replace("= 1.0", "= 2.0")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-8-sig"])
def test_an_estimate_in_any_encoding_of_a_table_has_its_axes(encoding, client, place):
    """PowerShell writes what it is given as UTF-16; the commands read it."""
    (place.folder / "estimate.csv").write_text(ESTIMATE, encoding)
    answer = client.get("/offsets")
    assert answer.status_code == 200
    assert 'name="axis:x"' in answer.text


def test_names_are_written_by_points_and_come_back_into_the_form(client, place):
    (place.folder / "part.step").write_text("")
    recorded(place, "part", "$ thermojoint mesh part.step --size-mm=5", "exit code 0")
    (place.folder / "faces.toml").write_text(FACES)
    names = {"bodies_mm:bed": "base", "joints:bed_block": "slide", "surfaces_mm:face_1": "foot"}
    assert sent(client, "/names", **names, **{"surfaces_mm:face_2": "foot"})[0] == 303
    ended(place)
    assert tomllib.loads(place.text("names.toml")) == {
        "bodies_mm": {"base": [0.0, 1.0, 2.0], "block": [9.0, 9.0, 9.0]},
        "joints": {"slide": ["base", "block"]},
        "surfaces_mm": {"foot": [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]},
    }
    page = client.get("/names").text
    for name in ("base", "slide", "foot"):
        assert f'value="{name}"' in page
    same = {"bodies_mm:bed": "b", "bodies_mm:block": "b"}
    assert "two have this name" in sent(client, "/names", **same)[1]
    assert "use letters" in sent(client, "/names", **{"bodies_mm:bed": "a b"})[1]


def test_names_of_faces_stay_unless_they_may_be_replaced_and_nothing_runs(client, place):
    (place.folder / "part.step").write_text("")
    (place.folder / "faces.toml").write_text(FACES)
    assert "faces.toml: exists already" in sent(client, "/part", part="part.step", size="5")[1]
    place.jobs.start("log", ["verify"])
    status, page = sent(client, "/part", part="part.step", size="5", replace="yes")
    place.jobs.cancel()
    assert status == 400
    assert "log: still runs" in page
    assert place.text("faces.toml") == FACES
    ended(place)


# Enabling


@pytest.fixture
def target(place):
    """The files of a target that nobody has enabled, and the record of a dry run."""
    settings = {"target.toml": TARGET, "service.toml": SERVICE, "model.json": "{}"}
    put(place, FOLLOWED | settings)

    def tried(code=0):
        writes = "time_s,axis,node,value,unit\n1,Z,a node,-15,um\n"
        put(place, {"offsets.csv": "time_s,offset_Z_um,state\n", "writes.csv": writes})
        said = (
            "$ thermojoint compensate estimate.csv --settings=offsets.toml --out=offsets.csv",
            "$ thermojoint target target.toml --offsets=offsets.csv --out=writes.csv",
            "$ thermojoint serve service.toml --check",
            f"exit code {code}",
        )
        recorded(place, "try", *said)

    return tried


def enabled(place):
    return tomllib.loads(place.text("target.toml")).get("enable", False)


def test_a_target_is_enabled_by_a_tick_after_the_dry_run_alone(client, place, target):
    assert "has not ended well" in sent(client, "/try", enable="yes", read="yes")[1]
    target(code=2)
    assert "has not ended well" in sent(client, "/try", enable="yes", read="yes")[1]
    target()
    assert "tick that" in sent(client, "/try", enable="yes")[1]
    assert not enabled(place)
    assert sent(client, "/try", enable="yes", read="yes")[0] == 303
    assert enabled(place)
    assert sent(client, "/try", disable="yes")[0] == 303
    assert not enabled(place)


def test_changed_settings_disable_the_target_until_they_are_tried(client, place, target):
    target()
    sent(client, "/try", enable="yes", read="yes")
    assert enabled(place)
    assert form(client, "/offsets", "offsets.toml", rate_um_s="3")[0] == 303
    ended(place)
    assert not enabled(place)
    assert "changed since: offsets" in sent(client, "/try", enable="yes", read="yes")[1]
    assert not enabled(place)


def test_another_model_has_to_be_tried_before_the_target_is_enabled(client, place, target):
    target()
    time.sleep(0.05)
    (place.folder / "model.json").write_text('{"learned": "anew"}')
    assert "changed since: model.json" in sent(client, "/try", enable="yes", read="yes")[1]
    assert not enabled(place)
    target()
    assert sent(client, "/try", enable="yes", read="yes")[0] == 303


def test_settings_that_change_during_the_dry_run_are_not_tried(client, place, target, monkeypatch):
    """The command that read them may have read the former ones."""

    def started(words, folder, output):
        for name in ("offsets.csv", "writes.csv"):
            (folder / name).write_text("")
        if words[0] == "serve":
            time.sleep(0.05)
            (folder / "target.toml").write_text(TARGET.replace("Z = 1", "Z = 2"))
        return subprocess.Popen(["true"])

    monkeypatch.setattr(jobs, "started", started)
    assert sent(client, "/try")[0] == 303
    ended(place)
    assert place.record("try").code == 0
    assert "changed since: target.toml" in sent(client, "/try", enable="yes", read="yes")[1]
    assert not enabled(place)


def test_the_form_of_a_target_cannot_enable_it(client, place, target):
    assert form(client, "/control", "target.toml", enable="true")[0] == 303
    assert not enabled(place)


def test_every_write_is_shown_before_it_is_enabled(client, place, target):
    target()
    page = client.get("/try").text
    assert "<td>a node</td><td>-15</td>" in page
    assert 'name="enable"' in page


def test_linuxcnc_is_shown_what_would_be_written_and_keeps_its_ini_file(client, place):
    ini = "[TRAJ]\nLINEAR_UNITS = mm\n[AXIS_Z]\nOFFSET_AV_RATIO = 0.1\n[HAL]\nHALFILE = a.hal\n"
    put(place, FOLLOWED | {"mill.ini": ini})
    begun = {"begin": "yes", "machine": "mill", "source": "csv", "kind": "linuxcnc"}
    assert sent(client, "/control", **begun)[0] == 303
    assert "exists already" in sent(client, "/control", **begun)[1]
    assert sent(client, "/try", ini="mill.ini")[0] == 303
    ended(place)
    page = client.get("/try").text
    assert "would write" in page
    assert "linuxcnc.token" in page
    assert stat.S_IMODE((place.folder / "linuxcnc.token").stat().st_mode) == 0o600
    # There is no model: a start would be refused, and nothing can be enabled.
    assert "has not ended well" in sent(client, "/try", enable="yes", read="yes")[1]
    assert place.text("mill.ini") == ini
    assert not (place.folder / "thermojoint.hal").exists()


# Both ways, with the commands of their steps


@pytest.fixture
def commands(place, monkeypatch):
    """What the steps run. It is not run: what it would write is there, as far as pages read it.

    A service runs until it is stopped.
    """
    found = []

    def started(words, folder, output):
        found.append(words)
        for word in words:
            option, _, name = word.partition("=")
            if option in ("--out", "--figure", "--faces", "--draft", "--case"):
                content = {"--draft": FACES, "--case": lasting(0.1)}.get(option, "")
                (folder / name).write_text(content)
        serves = words[0] == "serve" and "--check" not in words
        return subprocess.Popen(["sh", "-c", "trap '' HUP; exec sleep 60"] if serves else ["true"])

    monkeypatch.setattr(jobs, "started", started)
    yield found
    if place.jobs.detached:
        place.jobs.detached.kill()
        place.jobs.detached.wait()


@pytest.fixture
def ran(client, place, commands):
    """Send a form that is accepted, or that of a file of settings; gives the commands that it runs.

    Its page then shows them.
    """

    def run(page, file=None, **values):
        before = len(commands)
        status, text = form(client, page, file, **values) if file else sent(client, page, **values)
        assert status == 303, text
        ended(place)
        assert client.get(page).status_code == 200
        return commands[before:]

    return run


def test_from_a_log_to_offsets_every_step_runs_its_commands(client, place, ran):
    log = as_csv(machine_log(hours=6.0), place.folder / "log.csv")
    as_csv(machine_log(hours=1.0, seed=5), place.folder / "day.csv")
    assert ran("/log", log=log.name) == [["look", log.name, "--out=log.png"]]
    assert "choose at least one" in sent(client, "/learn", kind="learned")[1]
    wanted = {"displacement": "x_um", "ignore": "T6_degC", "kind": "ridge"}
    assert "no whole number" in sent(client, "/learn", most="few", **wanted)[1]
    (learned,) = ran("/learn", most="2", **wanted)
    assert learned == [
        *("learn", "log.csv", "--displacement=x_um", "--ignore=T6_degC", "--max-sensors=2"),
        *("--kind=ridge", "--out=model.json", "--figure=held-out.png"),
    ]
    assert client.get("/files/held-out.png").status_code == 200
    write_learned(learn([machine_log(hours=6.0)], ["x_um"], 1), place.folder / "model.json")
    assert "<option selected>day.csv" in client.get("/compare").text
    compared = ran("/compare", model="model.json", day="day.csv")
    assert compared == [
        ["estimate", "model.json", "day.csv", "--out=estimate.csv"],
        ["validate", "model.json", "day.csv", "--out=truth.png"],
    ]
    (place.folder / "estimate.csv").write_text(ESTIMATE)
    assert "name at least one axis" in sent(client, "/offsets", begin="yes")[1]
    assert ran("/offsets", begin="yes", **{"axis:x": "Z"}) == []
    assert tomllib.loads(place.text("offsets.toml"))["axes"]["Z"]["follows"] == "x"
    compensate = ["compensate", "estimate.csv", "--settings=offsets.toml", "--out=offsets.csv"]
    assert ran("/offsets", "offsets.toml", rate_um_s="50") == [compensate]


def test_a_control_is_tried_before_it_is_enabled_and_its_service_started_and_stopped(
    client, place, ran
):
    put(place, FOLLOWED | {"model.json": "{}"})
    begin = {"begin": "yes", "kind": "sinumerik", "machine": "mill", "source": "csv"}
    assert "use up to 64 letters" in sent(client, "/control", **begin | {"machine": "a mill"})[1]
    assert ran("/control", **begin) == []
    assert "exists already" in sent(client, "/control", **begin)[1]
    assert len(place.text("dashboard.token").strip()) == 48
    reached = {"url": "opc.tcp://127.0.0.1:4840", "security": "none"}
    assert ran("/control", "target.toml", **reached) == []
    port = {"http.port": str(free_port())}
    assert ran("/control", "service.toml", **port) == []
    tried = ran("/try")
    assert [words[0] for words in tried] == ["compensate", "target", "serve"]
    assert tried[1] == ["target", "target.toml", "--offsets=offsets.csv", "--out=writes.csv"]
    assert tried[2] == ["serve", "service.toml", "--check"]
    assert not enabled(place)
    assert ran("/try", enable="yes", read="yes") == []
    assert enabled(place)
    assert "does not run" in sent(client, "/run", stop="yes")[1]
    assert ran("/run", start="yes") == [["serve", "service.toml"]]
    assert "runs already" in sent(client, "/run", start="yes")[1]
    assert "The service runs" in client.get("/run").text
    assert ran("/run", reload="yes") == []
    assert place.jobs.detached.poll() is None
    assert ran("/run", stop="yes") == []
    assert place.jobs.detached.poll() is not None
    assert "The service does not run" in client.get("/run").text


def test_from_a_part_to_a_displacement_every_step_runs_its_commands(client, place, ran):
    (place.folder / "part.step").write_text("")
    assert "is no length" in sent(client, "/part", part="part.step", size="0")[1]
    assert ran("/part", part="part.step", size="20") == [
        ["mesh", "part.step", "--size-mm=20", "--draft=faces.toml", "--out=faces.msh"],
        ["inspect", "faces.msh", "--faces=faces.png"],
    ]
    names = {"surfaces_mm:face_1": "foot", "surfaces_mm:face_2": "warm"}
    assert ran("/names", **names) == [
        ["mesh", "part.step", "--size-mm=20", "--names=names.toml", "--out=part.msh"],
        ["inspect", "part.msh", "--faces=part.png", "--case=machine.toml"],
    ]
    step = {"march.step_s": "3.0"}
    assert ran("/case", "machine.toml", **step) == [
        ["inspect", "machine.toml", "--out=machine.png"]
    ]
    assert "exists already" in sent(client, "/case", begin="yes")[1]
    assert ran("/case", begin="yes", replace="yes") == [
        ["inspect", "part.msh", "--case=machine.toml"]
    ]
    ran("/case", begin="yes", replace="yes")
    former = place.folder.glob("machine.toml.*.former")
    assert len(list(former)) == 2, "each replaced file is kept, also within a second"
    assert ran("/result", deformed="yes") == [
        ["simulate", "machine.toml", "--out=machine.nc"],
        ["view", "machine.nc", "--out=curves.png"],
        ["view", "machine.nc", "--show=deformation", "--out=deformed.png"],
    ]
    assert "machine.toml" in client.get("/").text


def test_a_mesh_is_looked_at_in_its_unit(client, place, ran):
    (place.folder / "bars.msh").write_text("")
    assert ran("/part", part="bars.msh", unit="mm") == [
        ["inspect", "bars.msh", "--unit=mm", "--faces=faces.png", "--case=machine.toml"]
    ]
    assert all(client.get(f"/{page}").status_code in (200, 400) for page in PAGES)
    assert ran("/case", begin="yes", replace="yes") == [
        ["inspect", "bars.msh", "--unit=mm", "--case=machine.toml"]
    ]


# A file as a form


def test_a_form_keeps_what_it_does_not_change():
    fields = {field.name: field for field in fields_of(OFFSETS)}
    assert {name: (field.texts, field.given) for name, field in fields.items()} == {
        "rate_um_s": (["1.0"], True),
        "widest_band_um": ([""], False),
        "axes.Z.follows": (["x"], True),
        "axes.Z.sign": (["-1"], True),
    }
    assert fields["axes.Z.sign"].choices == ("-1", "1")
    assert changed(OFFSETS, {}, [*fields.values()]) == OFFSETS
    given = {"widest_band_um": ["20"], "axes.Z.follows": ['"y"'], "rate_um_s": [""]}
    new = changed(OFFSETS, given, [*fields.values()])
    assert tomllib.loads(new) == {
        "widest_band_um": 20,
        "axes": {"Z": {"follows": '"y"', "sign": -1}},
    }
    assert "# rate_um_s = 1.0  # fastest change" in new
    assert new.startswith("# Agreed with the operator.")


def test_of_several_sections_of_a_name_none_is_a_field():
    listed = "[[walls]]\nheight_mm = 1.0\n[march]\nstep_s = 2.0\n"
    fields = fields_of(listed)
    assert [field.name for field in fields] == ["march.step_s"]
    assert changed(listed, {"march.step_s": ["2.0"]}, fields) == listed


@given(
    st.text().filter(lambda text: len(text.strip().splitlines()) < 2),
    st.sampled_from(["rate_um_s", "axes.Z.follows", "axes.Z.sign"]),
)
def test_whatever_is_typed_changes_one_value_and_stays_toml(typed, name):
    new = tomllib.loads(changed(OFFSETS, {name: [typed]}, fields_of(OFFSETS)))
    *sections, last = name.split(".")
    before = tomllib.loads(OFFSETS)
    for data in (new, before):
        for section in sections:
            data = data.get(section, {})
        data.pop(last, None)
    assert {key: new.get(key) for key in before} == before


def test_a_value_over_several_lines_or_in_a_text_is_no_field():
    text = 'a = [\n  1,\n]\nb = """\nc = 1\n"""\n[[d]]\ne = 1\n[f]\ng = 2 # is # more\n'
    assert [(field.name, field.hint) for field in fields_of(text)] == [("f.g", "is # more")]


def test_what_a_record_reads_is_no_file_that_it_wrote_itself():
    record = Record((["learn", "a.csv", "--out=m.json"], ["estimate", "m.json", "b.csv"]))
    assert record.read == ["a.csv", "b.csv"]
    assert record.written == ["m.json"]
