"""LinuxCNC drives its axes by the offsets of the service: a real control, kills on each side."""

import contextlib
import os
import re
import shlex
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from linuxcnc_control import INI, control, needs_linuxcnc
from live_parts import free_port
from repository import ROOT
from warming_machine import RATE, prepare, started, warming_up

from thermojoint.artefacts.errors import InputError
from thermojoint.live.archive import Archive
from thermojoint.live.settings import read_service
from thermojoint.live.targets.linuxcnc import files_for
from thermojoint.live.targets.linuxcnc_component import (
    FOLLOW,
    HOLD,
    RETURN,
    Axis,
    Limits,
    Message,
    goal_of,
    message_of,
    state_of,
    stepped,
)

#: What a late loop of the component makes up for, and one step.
BURST_S, STEP_UM = 0.2, 0.11
#: A control that is simulated on a busy computer may stand still for this time, and then catch up.
STALL_S = 0.5
LIMITS = Limits(rate=1.0, largest=500.0, silence=10.0, hold=60.0)
PAGE = (ROOT / "docs" / "guide-linuxcnc.md").read_text("utf-8")
BLOCKS = dict(re.findall(r"^```(\w+)[^\n]*\n(.*?)^```", PAGE, re.M | re.S))
COMMANDS = re.findall(r"^thermojoint (.*)$", PAGE, re.M)


@pytest.fixture
def cnc(hand_made_model):
    """A control, and in its folder the files of the service."""
    with control() as made:
        http = f'[http]\nport = {free_port()}\nsecurity = "none"\n'
        prepare(made.folder, hand_made_model, BLOCKS["toml"] + http)
        yield made


def follow_the_page(place, command):
    ini = (place / "mill.ini").read_text("utf-8")
    for words in COMMANDS:
        code, told, said = command(*shlex.split(words))
        assert code == 0, said
        if words.startswith("tokens"):
            (place / "token.txt").write_text(told)
        elif "--write" not in words:
            assert "would write" in told
            assert not (place / "thermojoint.hal").exists()
    assert (place / "mill.ini.former").read_text("utf-8") == ini


@needs_linuxcnc
def test_a_control_follows_returns_when_the_service_is_killed_and_follows_again(
    cnc, command, monkeypatch
):
    place = cnc.folder
    monkeypatch.chdir(place)
    follow_the_page(place, command)
    archive = Archive(place / "state" / "history.sqlite")
    service = started(place)
    with contextlib.ExitStack() as ends:
        ends.callback(lambda: (service.kill(), service.wait()))
        ends.enter_context(warming_up(place))
        cnc.start()

        def asked():
            """The offset that the service has told last, um."""
            return 1e6 * archive.latest("mill").offsets[0]

        def follows():
            return abs(cnc.offset()) > 10.0 and abs(cnc.offset() - asked()) < 2.0

        cnc.until(follows)
        os.kill(service.pid, signal.SIGKILL)
        cnc.until(lambda: abs(cnc.offset()) < 0.05)
        service = started(place)
        cnc.until(follows)
        line = (cnc.folder / "thermojoint.hal").read_text().splitlines()[1]
        os.kill(cnc.pin("thermojoint.pid"), signal.SIGKILL)
        time.sleep(0.3)
        held = cnc.offset()
        time.sleep(0.5)
        assert cnc.offset() == pytest.approx(held, abs=0.01)
        cnc.run(line.split()[3:])
        cnc.until(follows)
        # The next component has taken over the counts of the one that was killed.
        assert abs(0.1 * cnc.pin("axis.z.eoffset-counts") - cnc.offset()) < 3.0
        record = cnc.record()
        # A control that is switched off forgets the offset, and is asked for it anew.
        (cnc.folder / "off").touch()
        cnc.until(lambda: not (cnc.folder / "off").exists())
        cnc.until(lambda: abs(cnc.offset()) < 1.0)
        cnc.until(follows)
        # Two minutes in all: the machine goes on warming up, the program running.
        time.sleep(80.0)
        assert follows()
    before, after, x, z, offset, asked = record.T
    # The program moves X all the time, and Z only by what is asked.
    assert min(np.ptp(part) for part in np.array_split(x, 5)) > 5000.0
    assert (np.abs(z - offset) <= RATE * (after - before + BURST_S) + STEP_UM).all()
    for lag_s in (0.0, 0.5, 2.0):
        later = np.searchsorted(before, before + lag_s, side="right").clip(max=len(z) - 1)
        most = RATE * (after[later] - before + BURST_S) + STEP_UM
        assert (np.abs(asked[later] - asked) <= most).all()
        assert (np.abs(z[later] - z) <= most + RATE * STALL_S).all()


@pytest.mark.parametrize("value", [None, "3", True, 501.0, float("nan")])
def test_a_word_that_is_none_is_refused(value):
    said = {"publications": [{"handshake": "stands", "offsets_um": {"Z": value}}]}
    with pytest.raises(ValueError, match="limit"):
        message_of(said, 2.0, LIMITS, Message(1.0, None))


def test_without_the_handshake_the_last_good_word_ages():
    stands = {"publications": [{"handshake": "stands", "offsets_um": {"Z": 3.0}}]}
    broken = {"publications": [{"handshake": "disabled", "offsets_um": {"Z": 2.0}}]}
    message = message_of(stands, 2.0, LIMITS, Message(1.0, None))
    assert message == Message(2.0, {"z": 3.0})
    assert message_of({"publications": []}, 5.0, LIMITS, message) == Message(5.0, {"z": 3.0})
    lost = message_of(broken, 5.0, LIMITS, message)
    states = [state_of(True, clock, lost, LIMITS) for clock in (5.0, 71.9, 72.1)]
    assert states == [HOLD, HOLD, RETURN]
    assert state_of(True, 2.1, message, LIMITS) == FOLLOW
    assert state_of(False, 2.1, message, LIMITS) == RETURN


def test_an_axis_that_the_service_no_longer_names_stays():
    message = Message(0.0, {"z": -12.0})
    assert [goal_of(FOLLOW, message, letter, 30) for letter in "zx"] == [-120, 30]
    assert [goal_of(state, message, "x", 30) for state in (HOLD, RETURN)] == [30, 0]


def test_a_step_waits_until_the_control_has_taken_the_last_one():
    """And one that it has lost, for it was off, is made good a second later."""
    first = stepped(Axis(100, 0, 0.0), 0, 30, 4, 0.05)
    assert first == Axis(104, 4, 0.05)
    assert stepped(first, 0, 30, 4, 0.1) == first
    assert stepped(first, 4, 30, 4, 0.1) == Axis(108, 8, 0.1)
    assert stepped(first, 0, 30, 4, 1.2) == Axis(108, 4, 1.2)


@pytest.fixture
def ini(tmp_path, hand_made_model):
    """The ini file of a control, beside the files of a service."""
    prepare(tmp_path, hand_made_model, BLOCKS["toml"] + '[http]\nsecurity = "none"\n')
    (tmp_path / "mill.ini").write_text(INI)
    return tmp_path / "mill.ini"


def made_for(ini, token="token"):
    service = read_service(ini.with_name("service.toml"))
    return files_for(service, "mill", ini, ini.with_name(token), None)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("OFFSET_AV_RATIO = 0.1\n", "", "the control ignores offsets"),
        ("[AXIS_Z]", "[AXIS_W]", "there is no [AXIS_Z]"),
        ("LINEAR_UNITS = mm", "LINEAR_UNITS = cubit", "write mm or inch"),
        ("HALFILE = LIB:basic_sim.tcl\n", "", "[HAL] has no HALFILE"),
    ],
)
def test_a_control_that_would_not_move_is_refused(old, new, told, ini):
    ini.write_text(INI.replace(old, new))
    with pytest.raises(InputError, match=re.escape(told)):
        made_for(ini)


def test_a_control_in_inches_gets_its_own_units(ini):
    ini.write_text(INI.replace("LINEAR_UNITS = mm", "LINEAR_UNITS = inch"))
    found = made_for(ini)
    assert "--units-per-mm=0.0393700787" in found[ini.with_name("thermojoint.hal")]
    assert found[ini].count("HALFILE") == 2


@pytest.mark.parametrize(
    ("address", "given", "url"),
    [
        ("::1", None, "https://[::1]:8443"),
        ("::", None, "https://127.0.0.1:8443"),
        ("127.0.0.1", "https://mill-pc.example:8443/", "https://mill-pc.example:8443"),
    ],
)
def test_the_component_finds_the_service(
    address, given, url, tmp_path, monkeypatch, hand_made_model
):
    prepare(tmp_path, hand_made_model, f'{BLOCKS["toml"]}[http]\naddress = "{address}"\n')
    monkeypatch.chdir(tmp_path)
    ini = Path("cnc") / "mill.ini"
    ini.parent.mkdir()
    ini.write_text(INI)
    found = files_for(read_service("service.toml"), "mill", ini, Path("token"), given)
    words = found[tmp_path / "cnc" / "thermojoint.hal"].split()
    assert f"--url={url}" in words
    assert f"--token-file={tmp_path}/token" in words
    (certificate,) = (message for message in words if message.startswith("--ca-file="))
    assert certificate.startswith(f"--ca-file={tmp_path}/")
    assert certificate.endswith("/http_certificate.pem")


def test_installing_again_leaves_a_switch_in_the_hal_file(ini):
    hal = ini.with_name("thermojoint.hal")
    first = made_for(ini)[hal]
    switched = first.replace("sets thermojoint-on TRUE", "net thermojoint-on <= halui.mode.is-auto")
    hal.write_text(switched)
    assert made_for(ini)[hal] == switched
    assert made_for(ini, "another")[hal] == switched.replace("/token ", "/another ")
    hal.write_text("sets thermojoint-on TRUE\n")
    with pytest.raises(InputError, match="in place of one; move the file away"):
        made_for(ini)


def test_an_axis_is_named_as_the_control_does(ini):
    """By another name what it acknowledges would be of no axis, and the handshake never stand."""
    offsets = ini.with_name("offsets.toml")
    offsets.write_text(offsets.read_text().replace("[axes.Z]", "[axes.z]"))
    with pytest.raises(InputError, match=r"no \[AXIS_z\]; name the axes in the offsets as here"):
        made_for(ini)
