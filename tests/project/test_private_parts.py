"""Private parts of libraries: one module fences each, and what it relies on is there.

A test here that fails after an upgrade names the module that has to be looked at. Once that works
with the new version, raise the upper bound in pyproject.toml.
"""

import ast
import asyncio
import tomllib

import aiomqtt
import meshio
import numba.np.linalg as numba_algebra
import numpy as np
import pytest
import uvicorn
from asyncua import ua
from asyncua.server import Server
from numba import types
from repository import ROOT
from uvicorn.protocols.http.h11_impl import H11Protocol

from thermojoint.live.opcua_internals import _ON_SUBSCRIPTIONS

#: The module that fences a library's private parts, and the library.
FENCES = {
    "fesim/joint/linear_system.py": "numba",
    "fesim/solid/pardiso.py": "pypardiso",
    "meshes/exchange.py": "meshio",
    "thermojoint/live/http/timeouts.py": "uvicorn",
    "thermojoint/live/mqtt_session.py": "aiomqtt",
    "thermojoint/live/opcua_internals.py": "asyncua",
}
#: What named tuples and the standard library offer in public under such a name.
PUBLIC = {"_replace", "_asdict", "_make", "_fields", "_exit"}


def product():
    for package in ("calibrate", "estimator", "fesim", "meshes", "thermojoint"):
        for path in sorted((ROOT / package).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), ast.parse(path.read_text("utf-8"))


def own_names(trees):
    """Names with an underscore that our own modules give to anything."""
    for _, tree in trees:
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                yield node.name
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                yield node.id
            elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                yield node.attr


def test_private_parts_are_touched_in_the_fences_alone():
    trees = list(product())
    own = set(own_names(trees)) | PUBLIC
    touching = set()
    for name, tree in trees:
        for node in ast.walk(tree):
            private = isinstance(node, ast.Attribute) and node.attr not in own and node.attr
            if isinstance(node, ast.ImportFrom) and node.module != "__future__":
                names = [*(node.module or "").split("."), *(alias.name for alias in node.names)]
                private = next((p for p in names if p.startswith("_") and p not in own), None)
            if private and private.startswith("_") and not private.startswith("__"):
                touching.add(name)
    assert touching == set(FENCES)


@pytest.mark.parametrize("library", sorted({*FENCES.values(), "h11"}))
def test_a_library_whose_private_parts_are_used_has_an_upper_bound(library):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    declared = [
        *project["dependencies"],
        *(one for extra in project["optional-dependencies"].values() for one in extra),
    ]
    (found,) = [one for one in declared if one.startswith(library)]
    assert "<" in found


def relied_on(what, where):
    return f"{what} is gone: read the library's changes, correct {where}, then raise the bound"


def test_numba_solves_systems_by_lapack_with_32_bit_pivots():
    where = "fesim/joint/linear_system.py"
    for kind in (types.float64, types.float32):
        what = numba_algebra._LAPACK().numba_xgesv(kind)
        expected = (types.char, types.intp, types.intp, types.CPointer(kind))
        assert what.sig.args[:4] == expected, relied_on("the arguments of numba_xgesv", where)
    assert numba_algebra.F_INT_nptype is np.int32, relied_on("F_INT_nptype", where)


def test_aiomqtt_shows_its_client_and_when_it_is_disconnected():
    where = "thermojoint/live/mqtt_session.py"

    async def made():
        return aiomqtt.Client("127.0.0.1")

    client = asyncio.run(made())
    assert isinstance(client._disconnected, asyncio.Future), relied_on("_disconnected", where)
    for name in ("ack", "manual_ack_set", "publish", "want_write"):
        assert callable(getattr(client._client, name, None)), relied_on(f"_client.{name}", where)


def test_asyncua_takes_the_limits_and_shows_its_nodes():
    where = "thermojoint/live/opcua_internals.py"

    async def looked_at():
        server = Server()
        await server.init()
        inner = server.iserver
        for name in (
            *("max_connections", "max_pending_activation_seconds", "max_session_timeout_ms"),
            *("max_subscriptions", "max_monitored_item_queue_size"),
            *("max_unacked_messages_per_subscription", "max_pending_messages_per_connection"),
        ):
            assert hasattr(inner, name), relied_on(f"iserver.{name}", where)
        node = inner.aspace._nodes[ua.NodeId(ua.ObjectIds.Server_ServerStatus_State)]
        value = node.attributes[ua.AttributeIds.Value]
        assert hasattr(value, "value_callback"), relied_on("value_callback", where)
        service = inner.subscription_service
        for name in ("create_monitored_items", "create_subscription"):
            assert asyncio.iscoroutinefunction(getattr(service, name)), relied_on(name, where)
        for name in (*_ON_SUBSCRIPTIONS, "browse", "history_read", "create_subscription"):
            assert callable(getattr(inner.isession, name)), relied_on(name, where)
        assert service.subscriptions == {}, relied_on("subscriptions", where)
        assert inner._external_sessions == {}, relied_on("_external_sessions", where)
        assert callable(inner.decrypt_user_token), relied_on("decrypt_user_token", where)

    asyncio.run(looked_at())
    from asyncua.server.monitored_item_service import MonitoredItemService

    made = MonitoredItemService.__init__.__code__.co_names
    assert "_monitored_items" in made, relied_on("_monitored_items", where)


def test_uvicorns_protocol_has_what_is_overridden():
    where = "thermojoint/live/http/timeouts.py"
    for name in (
        *("connection_made", "connection_lost", "data_received", "send_400_response"),
        *("pause_writing", "resume_writing", "_unset_keepalive_if_required"),
    ):
        assert callable(getattr(H11Protocol, name, None)), relied_on(name, where)

    async def made():
        config = uvicorn.Config(lambda: None, lifespan="off", log_config=None)
        config.load()
        return H11Protocol(config, uvicorn.Server(config).server_state, {})

    protocol = asyncio.run(made())
    for name in ("conn", "connections", "cycle", "client", "loop", "transport"):
        assert hasattr(protocol, name), relied_on(name, where)
    for name in ("capture_signals", "startup"):
        assert callable(getattr(uvicorn.Server, name, None)), relied_on(name, where)


def test_pypardiso_calls_mkl_without_comparing_the_matrix():
    pypardiso = pytest.importorskip("pypardiso")
    where = "fesim/solid/pardiso.py"
    solver = pypardiso.PyPardisoSolver(mtype=2)
    assert callable(solver._call_pardiso), relied_on("_call_pardiso", where)
    assert solver.libmkl._name, relied_on("libmkl", where)


def test_meshio_says_what_a_damaged_file_is():
    from meshio._exceptions import CorruptionError

    assert issubclass(CorruptionError, Exception), relied_on(
        "CorruptionError", "meshes/exchange.py"
    )
    assert issubclass(meshio.ReadError, Exception)
