"""The file of a service: what is wrong ends in one line; what is open to others is refused."""

import re
import stat
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from repository import ROOT

from benchmarks.offset_invariant import Gauge, model_with, settings_of
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.settings.section import Section
from thermojoint.live.certificates import own_identity
from thermojoint.live.consistency import contradictions
from thermojoint.live.loaded_models import load_model
from thermojoint.live.secret import read_secret
from thermojoint.live.settings import ModelSection, Secret, ServiceFile, service_from_data
from thermojoint.live.users import (
    MOST_TRIALS,
    PasswordCheck,
    UserLine,
    add_user,
    hashed,
    read_users,
)
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly

GOOD = {
    "folder": "state",
    "models": {"m": {"file": "m.json"}},
    "machines": {"mill": {"model": "m", "source": "s", "count": 3}},
    "sources": {"s": {"kind": "csv", "path": "{machine}.csv"}},
}


OFFSETS = {"m": {"file": "m.json", "offsets": "offsets.toml"}}


def source(**given):
    """The only source in another form."""
    return {"sources": {"s": given}}


def each_its_own(**given):
    """Two machines with a source each."""
    names = ("mill", "lathe")
    return {
        "machines": {name: {"model": "m", "source": name} for name in names},
        "sources": dict.fromkeys(names, given),
    }


def shaking(by, user=None, count=None, target=None, **parts):
    """A machine with a handshake, or several."""
    handshake = {"by": by} | ({} if user is None else {"user": user})
    mill = {"model": "m", "source": "s", "handshake": handshake, "count": count, "target": target}
    return {"machines": {"mill": mill}, **parts}


def test_a_section_with_a_count_is_so_many_machines(tmp_path):
    service = service_from_data(GOOD, "file", tmp_path)
    assert list(service.machines) == ["mill-1", "mill-2", "mill-3"]


def test_names_of_files_are_relative_to_the_file_of_the_service(tmp_path):
    service = service_from_data(
        GOOD
        | {
            "sources": GOOD["sources"] | {"piped": {"kind": "csv", "path": "-"}},
            "http": {"token": {"file": "token"}},
            "opcua": {"users": "users", "trusted": "/elsewhere"},
        },
        "file",
        tmp_path,
    )
    given = service.given
    assert service.folder == tmp_path / "state"
    assert given.models["m"].file == tmp_path / "m.json"
    assert given.sources["s"].path == tmp_path / "{machine}.csv"
    assert given.sources["piped"].path == Path("-")
    assert given.http.token.file == tmp_path / "token"
    assert (given.opcua.users, given.opcua.trusted) == (tmp_path / "users", Path("/elsewhere"))


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ({"models": {"m": {"file": "m.json", "intervall_s": 1.0}}}, "did you mean 'interval_s'"),
        ({"machines": {"mill": {"model": "n", "source": "s"}}}, "no model named 'n'"),
        ({"machines": {"a/b": {"model": "m", "source": "s"}}}, "a name is up to 64"),
        (source(kind="csv", path="one.csv"), "{machine}"),
        (
            source(kind="mqtt", topic="{machine}", security="none", host="10.0.0.7"),
            "which others reach",
        ),
        (
            source(kind="opcua", url="opc.tcp://plc", node="{machine}{reading}", security="none"),
            "which others reach",
        ),
        ({"opcua": {"security": "none", "address": "0.0.0.0"}}, "which others reach"),
        ({"mqtt": {"security": "none", "host": "broker"}}, "which others reach"),
        ({"mqtt": {"password": "secret"}}, "mqtt.password"),
        ({"mqtt": {"password": {"file": "a", "variable": "B"}}}, "one place"),
        ({"users": "users\0"}, "a null character"),
        ({"audit": {"largest_mb": 1e308}}, "audit.largest_mb"),
        ({"watchdog": {"uncertain_s": 10.0, "bad_s": 5.0}}, "bad_s"),
        ({"machines": {"mill": {"model": "m", "source": "s", "count": 10_001}}}, "10000"),
        (
            {
                "machines": {
                    "mill": {"model": "m", "source": "s", "count": 2},
                    "mill-1": {"model": "m", "source": "s"},
                }
            },
            "machines.mill-1: two sections give this machine",
        ),
        (
            shaking("target", models=OFFSETS, user="plc", target="t.toml"),
            "the file of a target names its own",
        ),
        (shaking("mqtt", mqtt={}), "sends no offsets"),
        (shaking("mqtt", models=OFFSETS), "there is no [mqtt]"),
        (shaking("opcua", models=OFFSETS, opcua={"security": "none"}), "name a file of users"),
        (shaking("mqtt", models=OFFSETS, mqtt={}, user="plc"), "broker says who"),
        (
            each_its_own(kind="mqtt", topic="plant"),
            "sources.lathe.client_id: sources.mill has the same at this broker",
        ),
        (
            each_its_own(kind="csv", path="-"),
            "sources.lathe.path: sources.mill reads standard input as well",
        ),
        (source(kind="mqtt", topic="hall/+/{machine}"), "sources.s.topic: 'hall/+/{machine}'"),
        ({"mqtt": {"topic": "{machine}/#"}}, "mqtt.topic: '{machine}/#': a topic has"),
        ({"mqtt": {"status_topic": ""}}, "mqtt.status_topic: '': a topic has"),
        ({"mqtt": {"topic": "estimates"}}, "mqtt.topic: is for 3 machines; write {machine}"),
        (
            shaking("mqtt", models=OFFSETS, mqtt={"control_topic": "plc"}, count=2),
            "mqtt.control_topic: is for 2 machines",
        ),
    ],
)
def test_a_mistake_is_one_line(parts, told, tmp_path):
    with pytest.raises(InputError) as found:
        service_from_data(GOOD | parts, "file", tmp_path)
    assert told in str(found.value)
    assert "\n" not in str(found.value)


class Banded(Gauge):
    """Its bands are given."""

    def __init__(self, *band):
        super().__init__(1.0)
        self.band = np.array(band)

    def sample(self, state, time, values):
        after, estimate = super().sample(state, time, values)
        return after, estimate._replace(band=self.band)


def test_settings_that_keep_values_from_being_good_are_said(tmp_path, hand_made_model):
    watchdog = {"uncertain_s": 0.5, "bad_s": 5.0}
    given = service_from_data(GOOD | {"watchdog": watchdog}, "file", tmp_path)
    output = settings_of({}, False)
    narrow = replace(output, trust=replace(output.trust, widest_band=1e-8))
    told = list(contradictions(given.given, {"m": model_with(narrow, 1.0)}))
    assert len(told) == 2
    assert "between samples" in told[0]
    assert "widest_band_um 0.01 is narrower than the model's own band, 0.1 um" in told[1]
    uneven = replace(model_with(narrow, 1.0), estimator=Banded(1e-7, 1e-9))
    assert list(contradictions(given.given, {"m": uneven})) == told
    other = replace(uneven, estimator=Banded(1e-9, 1e-7))
    assert len(list(contradictions(given.given, {"m": other}))) == 1
    unknown = replace(model_with(narrow, 1.0), estimator=Banded(np.nan, np.nan))
    assert "there is no band" in list(contradictions(given.given, {"m": unknown}))[1]
    write_assembly(assemble(hand_made_model, 60.0, 7200.0), tmp_path / "model.json")
    (tmp_path / "o.toml").write_text('oldest_s = 60.0\n[axes.X]\nfollows = "x"\n')
    section = ModelSection(
        file=tmp_path / "model.json", interval_s=60.0, offsets=tmp_path / "o.toml"
    )
    with pytest.raises(InputError, match="offsets would never follow"):
        load_model(section, tmp_path / "kept")


def test_a_service_runs_the_assembly_that_its_file_has(tmp_path, hand_made_model):
    """It went on with the former assembly of the same model."""
    section, digests = ModelSection(file=tmp_path / "estimator.json"), []
    for length in (7200.0, 86400.0):
        write_assembly(assemble(hand_made_model, 2.0, length), section.file)
        opened = load_model(section, tmp_path / "kept")
        assert opened.estimator.assembly.run_length_s == length
        digests.append(opened.digest)
    assert digests[0] != digests[1]


def test_without_protection_the_loopback_is_allowed(tmp_path):
    for host in ("127.0.0.1", "::1", "localhost"):
        mqtt = {"security": "none", "host": host}
        service_from_data(GOOD | {"mqtt": mqtt}, "file", tmp_path)


def test_a_secret_that_others_can_read_is_refused_and_never_shown(tmp_path, monkeypatch):
    path = tmp_path / "password"
    path.write_text("very-secret\n")
    path.chmod(0o644)
    with pytest.raises(InputError, match="chmod 600") as found:
        read_secret(Secret(file=tmp_path / "password"), "mqtt.password")
    assert "very-secret" not in str(found.value)
    path.chmod(0o600)
    assert read_secret(Secret(file=tmp_path / "password"), "x") == "very-secret"
    monkeypatch.setenv("MQTT_PASSWORD", "other")
    assert read_secret(Secret(variable="MQTT_PASSWORD"), "x") == "other"
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert read_secret(Secret(credential="password"), "x") == "very-secret"


def test_passwords_are_hashed_and_not_short():
    assert "correct" not in hashed("correct horse")
    with pytest.raises(InputError, match="8 to 256"):
        hashed("short")


def test_the_file_of_users_is_its_owners_alone(tmp_path):
    add_user(tmp_path / "users", "panel", "viewer", "panel-secret")
    add_user(tmp_path / "users", "setter", "operator", "setter-secret")
    assert stat.S_IMODE((tmp_path / "users").stat().st_mode) == 0o600
    found = read_users(tmp_path / "users")
    assert {name: line.role for name, line in found.items()} == {
        "panel": "viewer",
        "setter": "operator",
    }
    (tmp_path / "users").chmod(0o640)
    with pytest.raises(InputError, match="chmod 600"):
        read_users(tmp_path / "users")


def test_guessing_passwords_ends_soon_and_does_not_lock_out_who_is_known():
    users = {"panel": UserLine("viewer", hashed("panel-secret"))}
    known = PasswordCheck(users, _trials=[1.0] * (MOST_TRIALS - 1))
    assert known.principal("panel", "panel-secret", 1.0).role == "viewer"
    assert known.principal("panel", "wrong-secret", 1.0) is None
    assert known.principal("panel", "panel-secret", 1.0).role == "viewer"
    fresh = PasswordCheck(users, _trials=known._trials)
    assert fresh.principal("panel", "panel-secret", 2.0) is None
    assert fresh.principal("panel", "panel-secret", 100.0).role == "viewer"


def test_the_services_own_key_is_its_alone_and_stays(tmp_path):
    one = own_identity(tmp_path, ("mill.example",))
    assert stat.S_IMODE(one.key.stat().st_mode) == 0o600
    before = one.certificate.read_bytes()
    assert own_identity(tmp_path, ()).certificate.read_bytes() == before
    one.key.chmod(0o644)
    with pytest.raises(InputError, match="chmod 600"):
        own_identity(tmp_path, ())


def keys_of(kind):
    """Names of the keys of a section, and of all sections in it."""
    if isinstance(kind, type) and issubclass(kind, Section) and kind is not Secret:
        for name, field in kind.model_fields.items():
            yield field.alias or name
            yield from keys_of(field.annotation)
    for part in get_args(kind):
        yield from keys_of(part)


def test_every_key_has_its_place_on_the_page_of_the_settings():
    page = (ROOT / "docs" / "service-settings.md").read_text("utf-8")
    named = {part for name in re.findall(r"[`\[]([a-z_.]+)", page) for part in name.split(".")}
    sections = {"models", "machines", "sources", "kind", "columns"}
    assert set(keys_of(ServiceFile)) - sections <= named
