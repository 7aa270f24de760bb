"""Set up in a browser from end to end: the command, its pages, what they wrote, and what runs."""

import asyncio
import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import tomllib

import browser
import httpx
import pytest
from machine_logs import as_csv, machine_log
from played_control import Played
from repository import ROOT

from thermojoint.artefacts.response import read_response

PHONE, DESKTOP = {"width": 400, "height": 844}, {"width": 1200, "height": 800}
#: Long, since machine code may have to be compiled on a machine that many share.
WAIT_MS = 240_000
INTERVAL = 300.0

pytestmark = [pytest.mark.long, browser.needs_chromium]


@pytest.fixture(scope="module")
def chromium():
    with browser.chromium() as started:
        yield started


@pytest.fixture
def pages(chromium, tmp_path):
    """The pages of a folder as the command serves them, opened; every one fits its window."""
    command = [sys.executable, "-m", "thermojoint", "setup", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        link = re.search(r"http://\S+", process.stdout.readline())[0]
        context = chromium.new_context(viewport=PHONE)
        context.set_default_timeout(WAIT_MS)
        page = context.new_page()
        errors = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(link)
        yield page
        context.close()
        process.send_signal(signal.SIGINT)
        said = process.stdout.read()
        assert process.wait() == 0
        if goes_on := re.search(r"kill (\d+)", said):
            os.kill(int(goes_on[1]), signal.SIGKILL)
    assert errors == []


def do(page, selector):
    """Press a button, wait for the end of what it runs, and look at the page in both widths."""
    with page.expect_navigation():
        page.click(selector)
    page.wait_for_selector("#state[data-state=idle]", state="attached")
    for size in (DESKTOP, PHONE):
        page.set_viewport_size(size)
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    assert page.locator(".wrong").all_inner_texts() == []


def drawn(page, name):
    """Whether a picture is there and can be shown; the page may be read before its pictures are."""
    shown = "one => one.decode().then(() => one.naturalWidth, () => 0)"
    return page.locator(f"img[alt='{name}']").evaluate(shown) > 0


@contextlib.contextmanager
def played(log, path):
    """The machine is on: a line of the log every tenth of a second, an interval later each."""
    ended = threading.Event()
    names = [name for name in log.names if not name.endswith("_um")]
    values = [log.columns[log.index(name)].from_si(log.at(name)) for name in names]
    path.write_text(",".join(["time_s", *names]) + "\n")

    def tell():
        for k, row in enumerate(zip(*values, strict=True)):
            cells = [f"{1.7e9 + INTERVAL * k:.1f}", *(f"{one:.4f}" for one in row)]
            with path.open("a") as file:
                file.write(",".join(cells) + "\n")
            if ended.wait(0.1):
                return

    machine = threading.Thread(target=tell)
    machine.start()
    try:
        yield
    finally:
        ended.set()
        machine.join()


@contextlib.contextmanager
def control_on(path):
    """A SINUMERIK that is played; it takes writes of any size."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()

    def done(coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, loop).result(60.0)

    control = Played(path, "sinumerik", 1e3)
    done(control.open())
    try:
        yield control
    finally:
        done(control.server.stop())
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def port_for_long():
    """A free port that no connection of the browser takes meanwhile."""
    for port in range(20_000 + os.getpid() % 5000, 30_000):
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
    raise AssertionError("no port is free")


def test_from_a_log_to_a_control_that_follows(pages, tmp_path):
    page, port = pages, port_for_long()
    log = machine_log(hours=14.0, interval=INTERVAL)
    page.set_input_files("#file", as_csv(log, tmp_path.parent / f"{tmp_path.name}.csv"))
    page.wait_for_selector(".files a")
    (day,) = (path.name for path in tmp_path.glob("*.csv"))
    do(page, "text=I have a log")
    page.check(f"input[value='{day}']")
    do(page, "button.main")
    assert "168 rows" in page.inner_text(".said >> nth=0")
    do(page, "text=Next: Learn")
    page.uncheck("input[value=z_um]")
    do(page, "button.main")
    assert drawn(page, "held-out.png")
    do(page, "text=Next: Compare")
    do(page, "button.main")
    assert drawn(page, "truth.png")
    do(page, "text=Next: Offsets")
    page.fill("input[name='axis:x']", "Z")
    do(page, "button.main")
    filled = {"rate_um_s": "50", "oldest_s": "1e6", "recover_s": "0", "unusable": "[]"}
    for name, value in filled.items():
        page.fill(f"input[name={name}]", value)
    do(page, "button.main")
    with control_on(tmp_path.parent / f"{tmp_path.name}.toml") as control:
        do(page, "text=Next: Control")
        page.check("input[value=sinumerik]")
        do(page, "button.main")
        page.fill("input[name=url]", f"opc.tcp://127.0.0.1:{control.port}")
        page.select_option("select[name=security]", "none")
        page.fill("input[name=every_s]", "0.2")
        page.fill("input[name=largest_step_um]", "1e3")
        do(page, "form:has(input[name=url]) button.main")
        page.fill("input[name=behind_s]", "1e12")
        page.fill("input[name='http.port']", str(port))
        page.fill("input[name='machines.mill.handshake.differs_um']", "1e3")
        do(page, "form:has(input[name=behind_s]) button.main")
        do(page, "text=Next: Dry run")
        do(page, "button.main")
        assert "a start would succeed" in page.inner_text(".said")
        assert page.locator("td", has_text="SA_TEMP_COMP_ABS_VALUE[u3]").count() > 10
        assert control.record == []
        page.check("input[name=read]")
        do(page, "button[name=enable]")
        do(page, "text=Next: Run")
        do(page, "button.main")
        page.wait_for_selector("text=The service runs")
        with played(log, tmp_path / "mill.csv"):
            follows(port, page.inner_text("#token"), control)
        do(page, "text=Stop")
        page.wait_for_selector("text=The service does not run")
    assert tomllib.loads((tmp_path / "offsets.toml").read_text())["axes"]["Z"]["follows"] == "x"


def test_from_a_part_to_a_displacement(pages, tmp_path):
    page = pages
    page.set_input_files("#file", ROOT / "examples" / "clamp" / "clamp.step")
    page.wait_for_selector(".files a")
    do(page, "text=I have a part")
    page.fill("input[name=size]", "20")
    do(page, "button.main")
    assert drawn(page, "faces.png")
    do(page, "text=Next: Names")
    faces = {"bed, 8 cm2": "foot", "block, 20 cm2": "warm"}
    for hint, name in faces.items():
        page.locator(".field", has_text=hint).first.locator("input").fill(name)
    page.fill("input[name='bodies_mm:bed']", "base")
    page.fill("input[name='joints:bed_block']", "clamping")
    do(page, "button.main")
    assert drawn(page, "part.png")
    assert page.input_value("input[name='joints:bed_block']") == "clamping"
    do(page, "text=Next: Case")
    page.check("input[name='supports.fixed'][value=foot]")
    page.select_option("select[name='sources.heat.surface']", "warm")
    values = {
        "joints.clamping.preload_MPa": "2.0",
        "joints.clamping.along": "4",
        "joints.clamping.across": "3",
        "march.step_s": "30.0",
        "march.duration_min": "2.0",
        "probes.P.position_mm": "[100.0, 20.0, 40.0]",
    }
    for name, value in values.items():
        page.fill(f"input[name='{name}']", value)
    do(page, "button.main")
    assert drawn(page, "machine.png")
    do(page, "text=Next: Result")
    do(page, "button.main")
    assert drawn(page, "curves.png")
    response = read_response(tmp_path / "machine.nc")
    assert 1e-7 < float(abs(response["displacement"]).max()) < 1e-4
    assert set(tomllib.loads((tmp_path / "machine.toml").read_text())["bodies"]) == {
        "base",
        "block",
    }


def follows(port, token, control):
    """Wait until the offset stands against a displacement of some µm, and the control has it."""
    address = f"http://127.0.0.1:{port}/api/machines/mill/latest"
    end, told = time.monotonic() + WAIT_MS / 1000.0, {}
    while time.monotonic() < end:
        with contextlib.suppress(httpx.HTTPError):
            answer = httpx.get(address, headers={"authorization": f"Bearer {token}"})
            told = answer.json() if answer.status_code == 200 else {}
        moved, offset = told.get("displacement_um", {}), told.get("offsets_um", {})
        against = moved and abs(moved["x"] or 0.0) > 3.0 and abs(offset["Z"] + moved["x"]) < 1.0
        if against and abs(control.newest - offset["Z"]) < 3.0:
            return
        time.sleep(0.1)
    raise AssertionError((told, control.newest))
