"""Malformed requests at the service's HTTP door, over TLS on the loopback.

    python -m benchmarks.http_fuzz --count 5000

A server runs in a process of its own. Every request gets an answer below 500, or its connection is
closed; afterwards a well-formed request gets what it got before, and the process has not grown.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import json
import random
import socket
import ssl
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from benchmarks.study import options_of

TOKEN = "a-token-for-the-fuzz-alone-0123456789abcdef"
#: A server that neither answers nor closes for so long has hung, s.
PATIENCE_S = 15.0
#: Requests under way at the same time.
AT_ONCE = 8
#: How long the server waits here for a request to become whole, s.
REQUEST_S = 0.25
#: What the process may grow by, MB: fragments of malloc and OpenSSL; Python itself keeps nothing.
GROWTH_MB = 15.0
#: Requests before the first look at the server's memory: caches fill, pools grow to their size.
WARM = 1000

PATHS = (
    "/",
    "/login",
    "/machines/mill-1",
    "/api/machines",
    "/api/machines/mill-1/latest",
    "/api/machines/mill-1/history",
    "/api/machines/mill-1/scene",
    "/api/machines/mill-1/residuals",
    "/api/events",
    "/api/stream",
    "/metrics",
    "/healthz",
    "/assets/0/plotly.min.js",
    "/assets/../../etc/passwd",
    "/assets/%2e%2e/%2e%2e/etc/passwd",
    "//example.org/",
    "/api/machines/%00/latest",
    "/api/machines/mill-1%2flatest",
    "/api//machines",
    "*",
    "http://example.org/",
    "",
    "/%",
    "/%ff%fe",
    "/\\..\\",
)
METHODS = (
    "GET",
    "HEAD",
    "POST",
    "PUT",
    "DELETE",
    "OPTIONS",
    "TRACE",
    "CONNECT",
    "PRI",
    "get",
    "X" * 99,
)
QUERIES = (
    "",
    "points=99999999999999999999",
    "points=-1",
    "points=1e3",
    "since=1e400",
    "since=-inf",
    "since=0&until=1e11",
    "since=9999-12-31T23:59:59",
    "since=0001-01-01",
    "machine=",
    "machine=%00",
    "machine=mill-1&machine=mill-1",
    "every_s=nan",
    "&&&&=&;",
    "a=" + "b" * 1900,
    "a=" + "b" * 9000,
    "&".join("points=2" for _ in range(200)),
    "%zz=%",
    "points=%E2%82%AC",
)


@dataclass(frozen=True)
class Report:
    """What became of the requests."""

    #: Requests.
    sent: int
    #: Status to how often; 0 where the connection was closed without any.
    answers: Counter[int] = field(default_factory=Counter)
    #: Connections that were neither answered nor closed.
    unanswered: int = 0

    @property
    def server_errors(self) -> int:
        """Answers of 500 and above."""
        return sum(n for status, n in self.answers.items() if status >= 500)


def request(chance: random.Random) -> bytes:
    """Return one request, hardly ever a good one."""
    lines = [_first_line(chance)]
    lines += _credentials(chance)
    lines += _headers(chance)
    head = b"\r\n".join(line.encode("utf-8", "surrogateescape") for line in lines) + b"\r\n\r\n"
    whole = head + _body(chance)
    if chance.random() < 0.4:
        whole = _damaged(chance, whole)
    return whole


def _first_line(chance: random.Random) -> str:
    method = chance.choice(METHODS) if chance.random() < 0.4 else "GET"
    query = chance.choice(QUERIES)
    version = chance.choice(["HTTP/1.1"] * 8 + ["HTTP/1.0", "HTTP/2.0", "HTTP/9.9", ""])
    target = chance.choice(PATHS) + (f"?{query}" if query else "")
    return f"{method} {target} {version}"


def _credentials(chance: random.Random) -> list[str]:
    return chance.choice(
        [
            [f"Authorization: Bearer {TOKEN}"],
            [f"Authorization: Bearer {TOKEN}"],
            [f"Authorization: Bearer {TOKEN}"],
            [],
            [f"Authorization: Bearer {TOKEN[:-1]}\u20ac"],
            ["Authorization: Bearer " + "x" * chance.randrange(9000)],
            ["Authorization:"],
            [f"Authorization: Bearer {TOKEN}", "Authorization: Bearer x"],
            ["Cookie: thermojoint=" + "9" * chance.randrange(2000) + ".0"],
            ['Cookie: __Host-thermojoint=1e9.zz; ; =; a="b'],
            ["Cookie: " + ";" * 500],
        ]
    )


def _headers(chance: random.Random) -> list[str]:
    found = ["Host: localhost"] if chance.random() < 0.9 else []
    several = (
        "Host: a\r\nHost: b",
        "Content-Length: 5\r\nContent-Length: 6",
        "Content-Length: -1",
        "Content-Length: 99999999999999999999",
        "Content-Length: 3",
        "Transfer-Encoding: chunked",
        "Transfer-Encoding: chunked\r\nContent-Length: 3",
        "Transfer-Encoding: gzip, chunked",
        "Expect: 100-continue",
        "Connection: upgrade\r\nUpgrade: websocket",
        "Accept-Encoding: gzip;q=x, *",
        "Accept: text/html",
        "Range: bytes=0-18446744073709551615",
        "X-Forwarded-For: 192.0.2.1",
        "X: " + "y" * chance.choice([10, 5000, 20000]),
        "\x00: \x01",
        "no colon at all",
        " folded: yes",
        "Content-Type: multipart/form-data; boundary=",
        "If-None-Match: *",
    )
    found += chance.sample(several, chance.randrange(4))
    if chance.random() < 0.05:
        found += [f"X-{k}: y" for k in range(chance.choice([50, 400]))]
    return found


def _body(chance: random.Random) -> bytes:
    return chance.choice(
        [
            b"",
            b"",
            b"token=guess",
            b"token=" + b"%" * 3000,
            b"x" * 100_000,
            b"5\r\nhello\r\n0\r\n\r\n",
            b"ffffffffffffffff\r\nx",
            b"-5\r\nhello\r\n",
            b"5;" + b"e" * 3000 + b"\r\nhello",
            b"zz\r\n\r\n",
            chance.randbytes(200),
        ]
    )


def _damaged(chance: random.Random, whole: bytes) -> bytes:
    """Some bytes of it changed, lost or doubled, or its end missing."""
    found = bytearray(whole)
    for _ in range(chance.randrange(1, 6)):
        at = chance.randrange(len(found)) if found else 0
        what = chance.randrange(4)
        if what == 0 and found:
            found[at] = chance.randrange(256)
        elif what == 1:
            del found[at : at + chance.randrange(1, 20)]
        elif what == 2:
            found[at:at] = found[at : at + 40]
        else:
            found = found[: max(1, at)]
    return bytes(found)


def attack(port: int, count: int, seed: int, security: ssl.SSLContext) -> Report:
    """Send malformed requests, some at the same time, some with the right token.

    `port`: where the server listens. `count`, `seed`: how many, and which. `security`: for TLS; one
    in twenty sends what is no TLS.
    """
    with ThreadPoolExecutor(AT_ONCE) as threads:
        found = list(threads.map(lambda k: _sent(port, f"{seed} {k}", security), range(count)))
    hung = found.count(None)
    return Report(count, Counter(one for one in found if one is not None), hung)


def _sent(port: int, seed: str, security: ssl.SSLContext) -> int | None:
    """Send one request; return the status of the answer: 0 without one, None if nothing comes."""
    chance = random.Random(seed)
    content = request(chance)
    try:
        with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as plain:
            if chance.random() < 0.05:
                return _answer(plain, content)
            with security.wrap_socket(plain, server_hostname="127.0.0.1") as secured:
                return _answer(secured, content)
    except TimeoutError:
        return None
    except OSError:
        return 0


def _answer(line: socket.socket, content: bytes) -> int:
    line.sendall(content)
    # Nothing more comes: what is not whole never will be.
    if not isinstance(line, ssl.SSLSocket):
        line.shutdown(socket.SHUT_WR)
    said = b""
    while b"\r\n" not in said:
        part = line.recv(4096)
        if not part:
            return 0
        said += part
    words = said.split(b" ", 2)
    return int(words[1]) if words[0].startswith(b"HTTP/") else 0


def serve(folder: Path) -> None:
    """Run a server with one machine until it is killed; prints its port."""
    from prometheus_client import CollectorRegistry

    from estimator.interface import Channel
    from estimator.quality import Quality
    from thermojoint.live.access_store import digest_of, open_access
    from thermojoint.live.accounts import Accounts
    from thermojoint.live.archive import Archive
    from thermojoint.live.audit import Audit
    from thermojoint.live.http import timeouts
    from thermojoint.live.http.backend import Backend, MachineInfo
    from thermojoint.live.http.server import open_http, serve_http
    from thermojoint.live.publication import Layout, Publication, as_row
    from thermojoint.live.publisher import Publisher
    from thermojoint.live.rights import Principal
    from thermojoint.live.settings import HttpServer
    from thermojoint.live.store import Batch, Checkpoint, commit, era_of, open_store

    timeouts.REQUEST_S = REQUEST_S
    layout = Layout(("x", "y"), (), (Channel("heat_input", "1"),), ("T1_degC",))
    now = time.time()
    run = [
        Publication(
            "mill-1",
            k,
            now - 1000.0 + k,
            now,
            Quality.GOOD,
            layout,
            np.array([1e-6, 2e-6]),
            np.array([1e-7, 1e-7]),
            np.empty(0),
            np.array([1.0]),
            np.array([25.0]),
            "ok",
        )
        for k in range(1, 1001)
    ]
    store = open_store(folder / "store.db")
    era = era_of(store, "mill-1", "a model", layout, now)
    rows = np.array([as_row(one) for one in run])
    words = tuple(one.status for one in run)
    commit(store, Batch(checkpoints=[Checkpoint(era, 1000, b"", "{}", rows, words)]))
    store.close()
    reader = Principal("fuzz", credential=digest_of(TOKEN))
    accounts = Accounts(
        open_access(folder), Audit(folder / "audit.jsonl"), given={digest_of(TOKEN): reader}
    )
    publisher = Publisher()
    publisher.publish(run[-1:])
    about = MachineInfo(layout, "fchs", "model.json", now)
    backend = Backend(
        publisher, Archive(folder / "store.db"), {"mill-1": about}, CollectorRegistry(), {}, {}
    )
    section = HttpServer(port=0, requests_per_s=1e4)
    opened = open_http(section, backend, accounts, folder)
    print(opened.socket.getsockname()[1], flush=True)
    # As the service does: what stays for good is not looked through for garbage again and again,
    # which leaves the garbage collector time for connections that are over.
    gc.collect()
    gc.freeze()
    asyncio.run(serve_http(opened, asyncio.Event()))


def latest(port: int, security: ssl.SSLContext) -> dict[str, object]:
    """Return what the server says of its machine."""
    import httpx

    answer = httpx.get(
        f"https://127.0.0.1:{port}/api/machines/mill-1/latest",
        headers={"authorization": f"Bearer {TOKEN}"},
        verify=security,
        trust_env=False,
    )
    answer.raise_for_status()
    found: dict[str, object] = answer.json()
    return found


def main() -> int:
    """Attack a server of its own and say what came of it."""
    parser = options_of(__doc__)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve is not None:
        serve(given.serve)
        return 0
    with tempfile.TemporaryDirectory() as name:
        command = [sys.executable, "-m", "benchmarks.http_fuzz", "--serve", name]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                port = int(process.stdout.readline())
                return judge(process, port, Path(name), given.count, given.seed)
            finally:
                process.kill()


def judge(process: subprocess.Popen[str], port: int, folder: Path, count: int, seed: int) -> int:
    """Attack, look at the process before and after, print; return the exit code."""
    security = ssl.create_default_context(cafile=folder / "http_certificate.pem")
    before = latest(port, security)
    attack(port, WARM, seed + 1, security)
    server = psutil.Process(process.pid)
    held, begun = server.memory_info().rss, time.monotonic()
    report = attack(port, count, seed, security)
    seconds, grown = time.monotonic() - begun, (server.memory_info().rss - held) / 2**20
    same = latest(port, security) == before
    print(f"requests       {report.sent} in {seconds:.0f} s")
    print(f"answers        {json.dumps(dict(sorted(report.answers.items())))} (0: closed)")
    print(f"5xx            {report.server_errors}")
    print(f"hung           {report.unanswered}")
    print(f"memory         {held / 2**20:.0f} MB after {WARM} requests, {grown:+.1f} MB since")
    print(f"same answers   {'yes' if same else 'NO'}")
    alive = process.poll() is None
    good = (
        same and alive and not report.server_errors and not report.unanswered and grown < GROWTH_MB
    )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
