"""A service that asks for a reading of the displacement, and what becomes of the request."""

import asyncio
import math
import time
from dataclasses import replace

import httpx
import numpy as np
import pytest
from live_parts import PATIENCE_S, events_in, free_port, serving, until
from observed import SENSORS

from estimator.interface import NextReading
from estimator.joint_aware.model_file import write_observer
from thermojoint.artefacts.errors import InputError
from thermojoint.live.loaded_models import load_model
from thermojoint.live.next_reading import ReadingRequest, RequestLimits, after_sample, ended
from thermojoint.live.settings import ModelSection, NextReadingSection
from thermojoint.live.users import add_user

WIDE, NARROW, STATE = np.array([3e-6, 1e-6]), np.array([1e-6, 1e-6]), np.empty(0)
ASKED = NextReading("x", 0.0, 3e-6, 1e-6)


def limits(answer=ASKED):
    return RequestLimits(2e-6, 600.0, lambda state: answer)


def test_a_request_stands_until_its_axis_is_read_and_the_next_one_waits():
    one = after_sample(limits(), ReadingRequest(), 100.0, (), WIDE, STATE)
    assert (one.axis, one.outcome, one.since) == ("x", "asked", 100.0)
    assert after_sample(limits(), one, 102.0, ("y",), WIDE, STATE) == one
    taken = after_sample(limits(), one, 104.0, ("x",), WIDE, STATE)
    assert (taken.axis, taken.outcome) == ("", "taken")
    assert after_sample(limits(), taken, 703.0, (), WIDE, STATE) == taken
    assert after_sample(limits(), taken, 704.0, (), WIDE, STATE).axis == "x"


def test_a_request_is_withdrawn_once_the_band_is_narrow_again():
    one = after_sample(limits(), ReadingRequest(), 100.0, (), WIDE, STATE)
    assert after_sample(limits(), one, 102.0, (), NARROW, STATE).outcome == "withdrawn"
    later = limits(ASKED._replace(due=600.0))
    assert after_sample(later, ReadingRequest(), 100.0, (), WIDE, STATE) == ReadingRequest()


def test_nothing_is_asked_for_where_the_band_is_unknown_or_narrow():
    for band in (NARROW, np.full(2, math.nan)):
        assert after_sample(limits(), ReadingRequest(), 100.0, (), band, STATE) == ReadingRequest()
    postponed = ended(limits(), ReadingRequest("x", 100.0), 200.0, "postponed")
    assert after_sample(limits(), postponed, 500.0, (), WIDE, STATE).axis == ""


@pytest.fixture(scope="module")
def plant(watched, tmp_path_factory):
    """A folder with a model whose band is wide, and the samples of a warm-up."""
    folder, model = tmp_path_factory.mktemp("asking"), watched.estimator.model
    # A band of 5 um at a relaxed heat of one.
    wide = replace(model.band, square=np.full_like(model.band.square, 6e-12))
    write_observer(replace(model, band=wide), folder / "model.h5")
    add_user(folder / "users", "olga", "operator", "olgas-secret")
    return folder, watched.samples


def test_a_limit_that_no_reading_can_keep_is_refused(plant):
    folder, _ = plant
    section = ModelSection(file=folder / "model.h5", next_reading=NextReadingSection(above_um=0.2))
    with pytest.raises(InputError, match=r"next_reading.above_um: 0.2 um is below the .* larger"):
        load_model(section, folder / "kept")


def settings_of(port):
    return {
        "folder": "state",
        "users": "users",
        "models": {
            "m": {
                "file": "model.h5",
                "interval_s": 2.0,
                "reads": "above-ambient",
                "next_reading": {"above_um": 1.5, "interval_min": 1.0},
            }
        },
        "machines": {"mill": {"model": "m", "source": "line"}},
        "sources": {
            "line": {"kind": "csv", "path": "log.csv", "columns": {"x_um": "x_um", "y_um": "y_um"}}
        },
        "http": {"port": port, "security": "none"},
    }


def lines_of(samples, start, more="", ends=""):
    """A log of samples, to whose header and rows something is added."""
    yield ",".join(["time_s", *(f"{name}_K" for name in (*SENSORS, "ambient"))]) + more
    for at, *values in samples:
        yield f"{start + at:.1f},{','.join(map(str, values))}{ends}"


def test_an_operator_sees_the_request_and_postpones_it(plant):
    folder, samples = plant
    start, port = time.time() - 2.0 * len(samples), free_port()
    lines = list(lines_of(samples, start, ",x_um,y_um", ",,"))
    log = folder / "log.csv"
    log.write_text("\n".join(lines[:90]) + "\n")

    async def live():
        async with serving(settings_of(port), folder) as running:
            newest = running.publisher.newest
            await until(lambda: newest["mill"].request.axis)
            axis = newest["mill"].request.axis
            url = f"http://127.0.0.1:{port}"
            async with httpx.AsyncClient(base_url=url, trust_env=False, timeout=PATIENCE_S) as one:
                assert (await one.post("/machines/mill/next-reading")).status_code in (303, 401)
                await one.post("/login", data={"name": "olga", "token": "olgas-secret"})
                assert "Not now" in (await one.get("/machines/mill")).text
                told = (await one.get("/api/machines/mill/latest")).json()["next_reading"]
                assert told["axis"] == axis
                assert told["narrowed_um"] < told["band_um"]
                assert (await one.post("/machines/mill/next-reading")).status_code == 303
                assert newest["mill"].request.outcome == "postponed"
                metrics = (await one.get("/metrics")).text
                assert 'next_readings_total{machine="mill",outcome="postponed"} 1.0' in metrics
            with log.open("a") as more:
                more.write("\n".join(lines[90:]) + "\n")
            # A minute of samples later it asks again, and takes what is read.
            await until(lambda: newest["mill"].request.axis)
            last = start + samples[-1][0]
            more_lines = [f"{last + 2.0},{','.join(map(str, samples[-1][1:]))},"]
            read = ["3.0" if name == axis else "" for name in ("x", "y")]
            with log.open("a") as more:
                more.write(more_lines[0] + ",".join(read) + "\n")
            await until(lambda: newest["mill"].request.outcome == "taken")

    asyncio.run(live())
    texts = events_in(folder, "next-reading")
    assert texts[0] == "taken"
    assert "postponed" in texts
    assert any("would narrow" in text for text in texts)


def test_an_operator_enters_the_reading_on_the_page(plant):
    folder, samples = plant
    add_user(folder / "users", "vera", "viewer", "veras-secret")
    start, port = time.time() - 2.0 * len(samples), free_port()
    log = folder / "entered.csv"
    log.write_text("\n".join(lines_of(samples, start)) + "\n")
    settings = settings_of(port)
    settings |= {"folder": "entered", "sources": {"line": {"kind": "csv", "path": log.name}}}
    settings["models"]["m"]["lateness_s"] = 0.5

    async def live():
        async with serving(settings, folder) as running:
            newest, url = running.publisher.newest, f"http://127.0.0.1:{port}"
            await until(lambda: newest["mill"].request.axis)
            axis = newest["mill"].request.axis
            async with httpx.AsyncClient(base_url=url, trust_env=False, timeout=PATIENCE_S) as one:

                async def entered(text, reading=f"{axis}_um"):
                    return await one.post("/machines/mill/reading", data={reading: text})

                await one.post("/login", data={"name": "vera", "token": "veras-secret"})
                assert (await entered("3.0")).status_code == 403
                await one.post("/login", data={"name": "olga", "token": "olgas-secret"})
                for wrong in (await entered("three"), await entered(""), await entered("3", "q")):
                    assert wrong.status_code == 400
                assert "is not a number" in (await entered("1e9")).json()["error"]
                assert (await entered("3.0")).status_code == 303
            # It joins the next sample, which the one after it closes.
            with log.open("a") as more:
                for now in (time.time() + 0.1, time.time() + 2.1):
                    more.write(f"{now:.3f},{','.join(map(str, samples[-1][1:]))}\n")
            await until(lambda: newest["mill"].request.outcome == "taken")
            return axis

    axis = asyncio.run(live())
    said = "".join(file.read_text() for file in (folder / "entered").glob("audit*"))
    assert f'reading of {axis}_um = 3"' in said


def test_a_restart_keeps_the_request(plant):
    folder, _ = plant

    async def live():
        async with serving(settings_of(free_port()), folder) as running:
            return running.fleet.machines["mill"].state.request

    assert asyncio.run(live()).outcome == "taken"
