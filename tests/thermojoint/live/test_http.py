"""The door for browsers and programs: who passes, what is said, what is refused."""

import asyncio
import base64
import contextlib
import json
import math
import re
import resource
import socket
import ssl
import stat
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta

import httpx
import live_parts
import numpy as np
import pytest
from cryptography import x509
from dashboard_server import ABOUT, BEARER, TOKEN, again, event, keep, publication, serving
from hypothesis import given
from hypothesis import strategies as st
from live_parts import free_port
from repository import ROOT

from thermojoint.artefacts.errors import InputError
from thermojoint.live import limited_socket
from thermojoint.live.accounts import SHORTEST_TOKEN, checked
from thermojoint.live.certificates import HTTP_LASTS, own_certificate
from thermojoint.live.descriptors import RESERVE
from thermojoint.live.http import access, timeouts
from thermojoint.live.http.bodies import Messages, summary
from thermojoint.live.http.parameters import moment, read_parameters, whole_number
from thermojoint.live.http.stream import Subscriber, stream
from thermojoint.live.http.token_buckets import MOST_CLIENTS, RateLimit, client_of
from thermojoint.live.publication import as_json
from thermojoint.live.publisher import Publisher
from thermojoint.live.scene import Scene
from thermojoint.live.settings import HttpServer
from thermojoint.models.model_file import Provenance, write_model


@pytest.fixture(scope="module")
def floor(tmp_path_factory):
    """A server with two machines, one of which has never said anything."""
    folder = tmp_path_factory.mktemp("http")
    now = time.time()
    run = [publication(k, now - 100.0 + k) for k in range(1, 101)]
    archive = keep(folder / "store.db", [run], [event("mill-1", "status", "T2 is missing")])
    machines = {"mill-1": ABOUT, "mill-2": ABOUT}
    scene = Scene(
        {"surface": {"points_m": [[0.0], [0.0], [0.0]]}}, lambda: {"temperature_K": [1.0]}
    )
    residuals = {"mill-1": lambda: {"T1_K": 0.5, "T2_K": None}, "mill-2": lambda: None}
    given = {"handshakes": {"mill-1": lambda: {"state": "stands"}}, "requests_per_s": 1e4}
    with serving(
        *(folder, archive, machines, run[-1:], {"mill-1": scene}, residuals),
        most_streams=2,
        **given,
    ) as found:
        yield found


@pytest.fixture
def ask(floor):
    """Ask for an address as a program does."""
    with httpx.Client(base_url=floor.url, headers=BEARER, trust_env=False) as client:
        yield client


def lines(answer):
    """Events of a stream, as they come."""
    for line in answer.iter_lines():
        if line.startswith("data: "):
            yield json.loads(line.removeprefix("data: "))


# What is said


def test_the_latest_is_what_was_published(floor, ask):
    newest = floor.publisher.newest["mill-1"]
    assert ask.get("/api/machines/mill-1/latest").json() == as_json(newest)


def test_an_overview_says_the_same_in_fewer_words():
    one = publication(3, 1234.5)
    short, whole = summary(one), as_json(one)
    assert {key: whole[key] for key in short} == short
    assert set(short) < set(whole)


def test_what_is_said_is_put_into_words_once_for_all_who_listen():
    words, one = Messages(as_json), publication(1, 1.0)
    assert words(one) is words(one)
    assert json.loads(words(again(one, status="ok")))["status"] == "ok"
    assert len(words.cached) == 1


def test_all_machines_stand_in_the_overview_also_those_without_a_sample(ask):
    found = {one["machine"]: one for one in ask.get("/api/machines").json()["machines"]}
    assert found["mill-1"]["quality"] == "good"
    assert found["mill-2"] == {"machine": "mill-2", "kind": "joint-aware", "model": "mill.h5"}
    assert ask.get("/api/machines/mill-2/latest").status_code == 404


def test_the_history_is_thinned_to_what_was_asked_and_keeps_its_units(ask):
    whole = ask.get("/api/machines/mill-1/history").json()
    assert len(whole["time_s"]) == 100
    assert whole["displacement_um"]["x"] == pytest.approx(np.arange(1, 101))
    assert whole["band_um"]["y"] == [None] * 100
    assert set(whole["readings"]) == {"T1_degC", "T2_degC"}
    assert set(whole["details"]) == {"heat_spindle_W"}
    few = ask.get("/api/machines/mill-1/history?points=10").json()
    assert 5 <= len(few["time_s"]) <= 11
    assert few["every"] > 1


def test_events_come_with_their_time(ask):
    (found,) = ask.get("/api/events?machine=mill-1").json()["events"]
    assert found["text"] == "T2 is missing"
    assert datetime.fromisoformat(found["time"]).timestamp() == pytest.approx(
        found["time_s"], abs=0.01
    )


def test_a_machine_without_a_picture_says_so(ask):
    assert ask.get("/api/machines/mill-1/fields").json() == {"temperature_K": [1.0]}
    answer = ask.get("/api/machines/mill-2/scene")
    assert answer.status_code == 404
    assert "no picture" in answer.json()["error"]


def test_residuals_and_a_handshake_are_those_of_the_machine(ask):
    told = ask.get("/api/machines/mill-1/residuals").json()
    assert told == {"machine": "mill-1", "residuals_K": {"T1_K": 0.5, "T2_K": None}}
    told = ask.get("/api/machines/mill-1/handshake").json()
    assert told == {"machine": "mill-1", "state": "stands"}
    for page, said in (("residuals", "nothing is known"), ("handshake", "has no handshake")):
        answer = ask.get(f"/api/machines/mill-2/{page}")
        assert answer.status_code == 404
        assert said in answer.json()["error"]


@pytest.mark.parametrize("path", ["/", "/machines/mill-1"])
def test_a_page_has_its_own_files_alone_and_a_browser_may_keep_them(ask, path):
    """By their digest: a file that has changed has another address."""
    page = ask.get(path).text
    linked = re.findall(r"""(?:src|href)="([^"]+\.(?:js|css|svg))\"""", page)
    assert len(linked) > 3
    for address in linked:
        assert address.startswith("/assets/")
        packed = ask.get(address, headers={"accept-encoding": "gzip"})
        plain = ask.get(address, headers={"accept-encoding": "identity"})
        assert packed.headers["content-encoding"] == "gzip"
        assert packed.content == plain.content != b""
        assert "immutable" in plain.headers["cache-control"]
        _, _, digest, name = address.split("/")
        assert ask.get(f"/assets/{digest[::-1]}/{name}").status_code == 404
        assert ask.get(f"/assets/{digest}/no-{name}").status_code == 404


def test_prometheus_and_a_watchdog_find_what_they_look_for(floor, ask):
    assert "machines 2.0" in ask.get("/metrics").text
    health = httpx.get(f"{floor.url}/healthz").json()
    assert health == {"status": "ok", "machines": {"good": 1, "uncertain": 0, "bad": 0}}


@pytest.mark.parametrize(
    ("address", "says"),
    [
        ("/api/machines/mill-1/history?points=0", "points"),
        ("/api/machines/mill-1/history?points=١٢", "points"),
        ("/api/machines/mill-1/history?point=10", "did you mean 'points'"),
        ("/api/machines/mill-1/history?points=10&points=20", "twice"),
        ("/api/machines/mill-1/history?since=yesterday", "since"),
        ("/api/machines/mill-1/history?since=nan", "since"),
        ("/api/machines/mill-1/history?since=20&until=10", "not before"),
        ("/api/machines/mill-1/latest?x=1", "x"),
        ("/api/events?machine=mill-9", "mill-9"),
        ("/api/stream?every_s=0.001", "every_s"),
    ],
)
def test_a_bad_parameter_is_refused_in_one_line(ask, address, says):
    answer = ask.get(address)
    assert answer.status_code == 400
    assert says in answer.json()["error"]
    assert "\n" not in answer.json()["error"]


def test_an_unknown_machine_gets_the_nearest_name(ask):
    answer = ask.get("/api/machines/mil-1/latest")
    assert answer.status_code == 404
    assert "mill-1" in answer.json()["error"]


@given(st.text())
def test_no_text_is_read_as_anything_but_a_number_in_range(text):
    readers = {"points": whole_number(2, 5000)}
    if text.isascii() and text.isdigit() and 2 <= int(text) <= 5000 and len(text) < 10:
        assert read_parameters([("points", text)], readers) == {"points": int(text)}
        return
    with pytest.raises(InputError) as refusal:
        read_parameters([("points", text)], readers)
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 400


@given(st.floats(0.0, 4e9))
def test_a_time_is_the_same_in_seconds_and_as_a_date(seconds):
    named = datetime.fromtimestamp(seconds, UTC).isoformat()
    assert moment(named) == pytest.approx(moment(repr(seconds)), abs=1e-5)


# Who passes


def test_without_a_token_nothing_is_said(floor):
    for path in ("/api/machines", "/metrics", "/api/stream", "/no/such", "/api/machines/mill-9"):
        answer = httpx.get(f"{floor.url}{path}")
        assert answer.status_code == 401, path
        assert "mill" not in answer.text
    assert (
        httpx.get(f"{floor.url}/", headers={"accept": "text/html"}).headers["location"] == "/login"
    )


@pytest.mark.parametrize(
    "header",
    [
        TOKEN,
        f"Basic {base64.b64encode(f'x:{TOKEN}'.encode()).decode()}",
        f"Bearer {TOKEN[:-1]}",
        f"Bearer {TOKEN}x",
        "Bearer",
    ],
)
def test_what_is_not_quite_the_token_does_not_pass(floor, header):
    floor.forget_failures()
    answer = httpx.get(f"{floor.url}/api/machines", headers={"authorization": header})
    assert answer.status_code == 401


def test_the_log_in_turns_the_token_into_a_ticket_that_scripts_cannot_read(floor):
    floor.forget_failures()
    with httpx.Client(base_url=floor.url) as browser:
        assert browser.post("/login", data={"token": "wrong"}).status_code == 401
        answer = browser.post("/login", data={"token": TOKEN})
        assert answer.status_code == 303
        cookie = answer.headers["set-cookie"].lower()
        assert "httponly" in cookie
        assert "samesite=strict" in cookie
        assert TOKEN not in answer.headers["set-cookie"]
        assert browser.get("/api/machines").status_code == 200
        browser.post("/logout")
        assert browser.get("/api/machines").status_code == 401


def test_wrong_tokens_are_counted_and_the_right_one_still_passes(floor, ask):
    floor.forget_failures()
    wrong = {"authorization": f"Bearer {'guess' * 10}"}
    codes = [
        httpx.get(f"{floor.url}/metrics", headers=wrong).status_code
        for _ in range(int(access.WRONG_TOKENS) + 2)
    ]
    assert codes[0] == 401
    assert codes[-1] == 429
    assert httpx.post(f"{floor.url}/login", data={"token": TOKEN}).status_code == 429
    assert ask.get("/metrics").status_code == 200
    said = floor.audit()
    assert (said[-1]["from"], said[-1]["outcome"]) == ("http 127.0.0.1", "refused")
    assert "guess" not in str(said)
    floor.forget_failures()


def test_a_token_must_be_long():
    checked("x" * SHORTEST_TOKEN)
    with pytest.raises(InputError, match="at least 32") as refusal:
        checked("short secret")
    assert "short secret" not in str(refusal.value)


def test_headers_let_nothing_in_from_elsewhere(ask):
    headers = ask.get("/").headers
    policy = headers["content-security-policy"]
    assert "script-src 'self';" in policy
    assert "unsafe" not in policy
    assert headers["x-frame-options"] == "DENY"
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cache-control"] == "no-store"
    assert "server" not in headers


# Limits


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=200))
def test_no_client_gets_more_than_its_bucket_and_what_flows_in(pauses):
    buckets, now, passed = RateLimit(2.0, 5.0), 0.0, 0
    for pause in pauses:
        now += pause
        passed += buckets.take("one", now) == 0.0
    assert passed <= 5.0 + 2.0 * now + 1e-9


def test_many_clients_take_no_more_room_than_some():
    buckets = RateLimit(1.0, 1.0)
    for k in range(2 * MOST_CLIENTS):
        buckets.take(str(k), 0.0)
    assert len(buckets.levels) == MOST_CLIENTS
    assert client_of("2001:db8::1") == client_of("2001:db8::2") != client_of("2001:db8:0:1::1")


def test_long_addresses_and_bodies_are_refused(floor, ask):
    assert ask.get("/api/machines?" + "x" * 3000).status_code == 414
    assert ask.request("GET", "/api/machines", content=b"x").status_code == 413
    floor.forget_failures()
    assert ask.post("/login", content=b"token=" + b"x" * 5000).status_code == 413
    assert ask.get("/api/machines", headers={"x": "x" * 20000}).status_code in (400, 431)
    assert ask.delete("/api/machines").status_code == 405


def test_a_body_that_no_request_has_is_refused_in_words_every_time(ask):
    """On a connection that is kept, the body may come after the server has decided."""
    for _ in range(50):
        assert ask.get("/api/machines?" + "x" * 3000).status_code == 414
        assert ask.request("GET", "/api/machines", content=b"x").status_code == 413


def test_streams_are_counted_and_given_back(floor, ask):
    with contextlib.ExitStack() as opened:
        for _ in range(2):
            answer = opened.enter_context(ask.stream("GET", "/api/stream"))
            assert answer.status_code == 200
        assert ask.get("/api/stream").status_code == 429
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        with ask.stream("GET", "/api/stream") as answer:
            if answer.status_code == 200:
                return
        time.sleep(0.05)
    raise AssertionError("a stream that was left is still counted")


@pytest.mark.parametrize(("descriptors", "of_one"), [(12, 100), (100, 4)])
def test_connections_leave_descriptors_for_the_files_and_room_for_others(
    monkeypatch, descriptors, of_one
):
    """And behind a proxy, which has one address, the settings may let it have more."""
    # Numbers that are free may have others between them.
    with contextlib.ExitStack() as opened:
        free = [opened.enter_context(socket.socket()).fileno() for _ in range(descriptors + 1)]
        limit = free[-1] + RESERVE
    monkeypatch.setattr(resource, "getrlimit", lambda _: (limit, limit))
    taken = []
    with contextlib.ExitStack() as opened:
        ours = socket.create_server(("127.0.0.1", 0))
        listening = opened.enter_context(limited_socket.LimitedSocket(ours, 100, of_one))
        for _ in range(10):
            opened.enter_context(socket.create_connection(listening.getsockname()))
            with contextlib.suppress(ConnectionAbortedError):
                taken.append(opened.enter_context(listening.accept()[0]))
    assert 3 <= len(taken) <= 6


def test_nobody_takes_all_the_connections(floor, ask):
    """Those of one address that are too many end before TLS; the others are answered."""
    host, port = floor.url.rpartition("/")[2].split(":")
    many = [socket.create_connection((host, int(port))) for _ in range(200)]
    time.sleep(0.2)
    ended = 0
    for one in many:
        one.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            ended += one.recv(1) == b""
    assert 200 - 128 <= ended < 200
    for one in many:
        one.close()
    assert httpx.get(f"{floor.url}/healthz").status_code == 200


def test_whoever_sends_half_a_request_is_not_waited_for(floor, monkeypatch):
    monkeypatch.setattr(timeouts, "REQUEST_S", 0.2)
    host, port = floor.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as slow:
        slow.sendall(b"GET /healthz HTTP/1.1\r\nHost: x\r\n")
        slow.settimeout(5.0)
        with contextlib.suppress(ConnectionResetError):
            assert slow.recv(100) == b""


# The stream


def test_a_stream_tells_what_is_there_and_then_what_is_new(floor, ask):
    with ask.stream("GET", "/api/stream?machine=mill-1&every_s=0.1") as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        told = lines(answer)
        newest = floor.publisher.newest["mill-1"]
        assert next(told)["publications"] == [as_json(newest)]
        later = again(newest, displacement=np.array([5e-6, 6e-6]))
        floor.publish(later)
        assert next(told)["publications"] == [as_json(later)]


def test_a_slow_reader_gets_the_newest_and_holds_nothing():
    """A hundred publications while it sleeps are one event."""

    async def slow():
        publisher = Publisher()
        publisher.publish([publication(1, 1.0)])
        found = stream(
            publisher, Subscriber(frozenset(["mill-1"]), 0.0, lambda: True), Messages(as_json)
        )
        await anext(found)
        first = json.loads((await anext(found)).split(b"data: ")[1])
        for k in range(2, 102):
            publisher.publish([publication(k, float(k))])
        second = json.loads((await anext(found)).split(b"data: ")[1])
        await found.aclose()
        assert not publisher._subscriptions
        return [one["publications"][0]["number"] for one in (first, second)]

    assert asyncio.run(slow()) == [1, 101]


def test_a_stream_without_news_goes_on_telling_the_time():
    async def idle():
        found = stream(
            Publisher(), Subscriber(frozenset(["mill-1"]), 0.0, lambda: True), Messages(as_json)
        )
        await anext(found)
        beat = json.loads((await anext(found)).split(b"data: ")[1])
        await found.aclose()
        return beat

    before = time.time()
    beat = asyncio.run(idle())
    assert beat["publications"] == []
    assert before < beat["now_s"] <= time.time()


# TLS


def test_the_certificate_of_its_own_is_checked_made_once_and_renewed(tmp_path):
    here, there = HttpServer(), HttpServer(address="192.0.2.7")
    own = own_certificate(tmp_path, here)
    certificate = own.certificate
    assert stat.S_IMODE(own.key.stat().st_mode) == 0o600
    before = certificate.read_bytes()
    own_certificate(tmp_path, here)
    assert certificate.read_bytes() == before
    own_certificate(tmp_path, there)
    assert certificate.read_bytes() != before
    own_certificate(tmp_path, there, datetime.now(UTC) + HTTP_LASTS - timedelta(days=1))
    ends = x509.load_pem_x509_certificate(certificate.read_bytes()).not_valid_after_utc
    assert ends > datetime.now(UTC) + HTTP_LASTS


def test_tls_is_what_is_spoken_and_the_ticket_is_for_it_alone(tmp_path):
    machines = {"mill-1": ABOUT}
    archive = keep(tmp_path / "store.db", [[publication(1, time.time())]])
    section = HttpServer(host_names=("mill-pc.example",))
    own_certificate(tmp_path, section)
    with serving(tmp_path, archive, machines, [], security="tls") as found:
        trusted = ssl.create_default_context(cafile=tmp_path / "http_certificate.pem")
        with httpx.Client(base_url=found.url, verify=trusted, trust_env=False) as browser:
            answer = browser.post("/login", data={"token": TOKEN})
            cookie = answer.headers["set-cookie"]
            assert cookie.startswith("__Host-")
            assert "secure" in cookie.lower()
            assert "strict-transport-security" in answer.headers
            assert browser.get("/api/machines").status_code == 200
            # The names of the certificate are the service's own.
            assert browser.get("/healthz", headers={"host": "mill-pc.example"}).status_code == 200
        plain = found.url.replace("https", "http")
        with pytest.raises(httpx.HTTPError):
            httpx.get(f"{plain}/healthz")


def test_without_tls_nobody_else_can_reach_it(tmp_path):
    with (
        pytest.raises(InputError, match="which others reach"),
        serving(tmp_path, None, {}, [], address="0.0.0.0"),
    ):
        pass


def test_an_address_that_is_taken_is_one_line(tmp_path):
    port = free_port()
    with (
        socket.create_server(("127.0.0.1", port)),
        pytest.raises(InputError, match=f"cannot listen at 127.0.0.1:{port}"),
        serving(tmp_path, None, {}, [], port=port),
    ):
        pass


def test_a_key_without_its_certificate_is_refused():
    with pytest.raises(ValueError, match="belong together"):
        HttpServer(key_file="key.pem")


# The service


def test_a_service_opens_this_door_by_its_file(tmp_path, hand_made_model):
    """From a line of CSV to what a program is told of it."""
    write_model(hand_made_model, tmp_path / "model.json", Provenance(case="by hand"))
    token = tmp_path / "token"
    token.touch(mode=0o600)
    token.write_text(TOKEN)
    now = math.floor(time.time()) - 30
    rows = [f"{now + 2 * k},{20 + k / 10},20,20,20,20" for k in range(10)]
    lines = ["time_s,a_degC,b_degC,T1_degC,T2_degC,ambient_degC", *rows]
    (tmp_path / "mill-1.csv").write_text("\n".join(lines) + "\n")
    data = {
        "folder": "kept",
        "models": {"mill": {"file": "model.json", "interval_s": 2.0, "run_length_min": 20.0}},
        "machines": {"mill-1": {"model": "mill", "source": "csv"}},
        "sources": {"csv": {"kind": "csv", "path": "{machine}.csv"}},
        "http": {"port": free_port(), "token": {"file": "token"}},
    }

    async def told():
        async with live_parts.serving(data, tmp_path) as running:
            await live_parts.until(lambda: running.publisher.newest["mill-1"].number == 10)
            trusted = ssl.create_default_context(cafile=tmp_path / "kept" / "http_certificate.pem")
            url = f"https://127.0.0.1:{data['http']['port']}"
            async with httpx.AsyncClient(
                base_url=url, headers=BEARER, verify=trusted, trust_env=False
            ) as client:
                paths = ("", "/latest", "/history")
                answers = [await client.get(f"/api/machines/mill-1{path}") for path in paths]
                return as_json(running.publisher.newest["mill-1"]), [one.json() for one in answers]

    newest, (stays, latest, history) = asyncio.run(told())
    assert latest["displacement_um"] == newest["displacement_um"]
    assert stays["kind"] == "fchs"
    assert stays["model"] == "model.json"
    assert {"time since the start", "heat", "T1"} <= {one["name"] for one in stays["valid"]}
    assert len(history["time_s"]) == 10
    assert history["readings"]["a_degC"][-1] == pytest.approx(20.9)


# Anything


def test_malformed_requests_find_nothing():
    """In processes of their own: neither side can take the test's down."""
    command = [sys.executable, "-m", "benchmarks.http_fuzz", "--count", "80", "--seed", "12"]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=180)
    assert found.returncode == 0, found.stdout + found.stderr
