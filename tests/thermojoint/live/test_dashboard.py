"""The dashboard in a browser: what the service says stands on the page, and old values look old."""

import time
from dataclasses import replace

import browser
import numpy as np
import pytest
from dashboard_server import TOKEN, about, again, event, keep, layout_of, published, serving
from observed import estimates

from estimator.quality import Quality
from thermojoint.artefacts.quantities import UNITS
from thermojoint.live.publication import AxisLine, as_json
from thermojoint.live.scene import scene_of
from thermojoint.live.surface import surface_of, write_surface

PHONE, PANEL = {"width": 390, "height": 844}, {"width": 1024, "height": 768}
WAIT_MS = 15_000

pytestmark = [pytest.mark.long, browser.needs_chromium]


@pytest.fixture(scope="module")
def floor(tmp_path_factory, watched):
    """Three machines of a simulated warm-up; one has lost a sensor, one says nothing more."""
    folder = tmp_path_factory.mktemp("dashboard")
    case, setup, _, estimator = watched
    samples = watched.samples
    state, found = estimates(estimator, samples)
    surface = surface_of(case, setup, estimator.model, np.array([0.0, 1.0, 0.0]))
    write_surface(surface, folder / "scene.h5")
    scenes = {"mill-1": scene_of(folder / "scene.h5", estimator, lambda: state)}
    layout = replace(layout_of(estimator, ("X", "Y")), lines=(AxisLine("X", 0.25, 0.3),))
    differ = {"mill-10": lambda: {"T1_K": 5.25, "T2_K": None}}
    told = published("mill-1", layout, found, samples, time.time() - samples[-1][0])
    told = [replace(one, slopes=np.array([40e-6])) for one in told]
    silent = replace(told[-1], machine="mill-2", quality=Quality.BAD, status="silent")
    partial = replace(
        told[-1],
        machine="mill-10",
        quality=Quality.UNCERTAIN,
        status="reading-missing:T2 sensor-distrusted:T1",
        readings=np.where(np.array(layout.readings) == "T2_K", np.nan, told[-1].readings),
    )
    runs = [told, [silent], [partial]]
    archive = keep(folder / "store.db", runs, [event("mill-10", "status", "T1 is distrusted")])
    machines = {run[-1].machine: about(estimator, layout, told[0].time) for run in runs}
    newest = [one[-1] for one in runs]
    said = {"state": "differs", "enabled": True, "heartbeat": 17, "heartbeat_age_s": 0.4}
    said |= {"acknowledged_um": {"X": -12.3, "Y": None}, "acknowledged_slopes_um_per_m": {"X": 38}}
    handshakes = {"mill-1": lambda: said}
    given = {"handshakes": handshakes, "requests_per_s": 1e3}
    with serving(folder, archive, machines, newest, scenes, differ, **given) as server:
        yield server


@pytest.fixture(scope="module")
def chromium():
    with browser.chromium() as started:
        yield started


@pytest.fixture
def page(chromium, floor):
    """A page that is logged in, and complains of nothing."""
    context = chromium.new_context(viewport=PANEL)
    context.set_default_timeout(WAIT_MS)
    context.request.post(f"{floor.url}/login", form={"token": TOKEN})
    found = context.new_page()
    errors = []
    found.on("pageerror", lambda error: errors.append(str(error)))
    yield found
    context.close()
    assert errors == []


def opened(page, floor, path):
    """Go to a page and wait until the stream is live."""
    page.goto(f"{floor.url}{path}")
    page.wait_for_selector("#line[data-state=live]")


def until(page, expression):
    """Wait until an expression holds; the browser's own way would need eval, which pages refuse."""
    deadline = time.monotonic() + WAIT_MS / 1000.0
    while not holds(page, expression):
        assert time.monotonic() < deadline, expression
        page.wait_for_timeout(50)


def holds(page, expression):
    """Whether an expression holds; on a page that is just loaded anew, not yet."""
    from playwright.sync_api import Error

    try:
        return page.evaluate(expression)
    except Error as error:
        if "navigation" not in str(error):
            raise
        return False


def number(text):
    """What stands on the page, as a number."""
    return float(text.replace("−", "-"))


def curve(page, chart, name):
    """Values of a drawn curve."""
    return page.evaluate(
        "([chart, name]) => document.querySelector(chart).data.find((one) => one.name === name).y",
        [chart, name],
    )


def test_a_sample_from_before_the_clock_was_set_back_has_no_age(page, floor):
    opened(page, floor, "/")
    ages = page.evaluate("[-3600, NaN, -30, 90].map(age)")
    assert ages == ["–", "–", "now", "90 s ago"]


def test_the_dashboard_asks_for_the_token(chromium, floor):
    context = chromium.new_context(viewport=PHONE)
    page = context.new_page()
    page.goto(f"{floor.url}/machines/mill-1")
    assert page.url == f"{floor.url}/login"
    page.fill("#token", "wrong")
    page.click("button.main")
    assert "are wrong" in page.inner_text("[role=alert]")
    page.fill("#token", TOKEN)
    page.click("button.main")
    page.wait_for_selector("#line[data-state=live]")
    assert page.evaluate("document.cookie") == ""
    page.click("text=Log out")
    page.wait_for_url("**/login")
    context.close()


def test_the_overview_shows_every_machine_worst_first(page, floor):
    opened(page, floor, "/")
    names = page.locator(".tile-name").all_inner_texts()
    assert names == ["mill-2", "mill-10", "mill-1"]
    assert page.inner_text("#counts") == "1 bad · 1 uncertain · 1 good"
    tile = page.locator(".tile", has_text="mill-10")
    assert "T1: left out" in tile.inner_text()
    told = as_json(floor.publisher.newest["mill-1"])["displacement_um"]
    shown = page.locator(".tile", has_text="mill-1").last.locator(".tile-axis b").all_inner_texts()
    assert [number(one) for one in shown] == pytest.approx(list(told.values()), abs=0.051)
    page.fill("#find", "10")
    assert page.locator(".tile:visible").count() == 1


def test_the_overview_forgets_the_axes_of_a_model_that_was_replaced(page, floor):
    opened(page, floor, "/")
    before = floor.publisher.newest["mill-1"]
    layout = replace(before.layout, axes=("x",), controls=("X",), lines=())
    one = {"displacement": np.array([77.7e-6]), "band": np.array([1e-6]), "slopes": np.empty(0)}
    floor.publish(again(before, layout=layout, offsets=np.array([0.0]), **one))
    until(page, "document.querySelector('a[href$=\"mill-1\"]').innerText.includes('+77.7')")
    assert page.locator('a[href$="mill-1"] .axis').all_inner_texts() == ["x"]
    floor.publish(again(before))
    until(page, "document.querySelectorAll('a[href$=\"mill-1\"] .axis').length === 2")


def test_the_page_of_a_machine_says_what_the_service_says(page, floor):
    opened(page, floor, "/machines/mill-1")
    until(page, "!!document.querySelector('#c-displacement').data")
    told = as_json(floor.publisher.newest["mill-1"])
    assert page.inner_text("#word").lower() == "good"
    for axis in ("x", "y"):
        assert number(page.inner_text(f"#axis-{axis} .number")) == pytest.approx(
            told["displacement_um"][axis], abs=0.051
        )
        assert f"{told['band_um'][axis]:.2f}" in page.inner_text(f"#axis-{axis} .band")
    assert number(page.inner_text("#offset-X .number")) == pytest.approx(
        told["offsets_um"]["X"], abs=0.051
    )
    assert page.inner_text("#offset-X .band") == "K0 sent, at P0 = 250.0 mm; tan β +40.0 µm/m"
    assert page.inner_text("#offset-Y .band") == "offset sent"
    assert page.locator("h2", has_text="Slope sent to the control, µm/m").count() == 1
    past = page.request.get(f"{floor.url}/api/machines/mill-1/history?points=720").json()
    assert set(past["slopes_um_per_m"]["X"]) == {40.0}
    drawn = curve(page, "#c-displacement", "δx")
    assert len(drawn) > 100
    assert drawn[: len(past["time_s"])] == past["displacement_um"]["x"][: len(drawn)]
    valid = page.inner_text("#valid")
    assert "T1" in valid
    assert "time since the start" in valid


def test_what_is_new_is_drawn_into_the_charts_that_are_there(page, floor):
    opened(page, floor, "/machines/mill-1")
    until(page, "!!document.querySelector('#c-displacement').data")
    page.evaluate("window.kept = document.querySelector('#c-displacement .main-svg')")
    before = floor.publisher.newest["mill-1"]
    floor.publish(again(before, displacement=np.array([123.4e-6, -56.7e-6])))
    until(page, "document.querySelector('#axis-x .number').textContent === '+123.4'")
    until(
        page, "document.querySelector('#c-displacement').data.some((one) => one.y.at(-1) === 123.4)"
    )
    assert page.evaluate("document.querySelector('#c-displacement .main-svg') === window.kept")
    floor.publish(again(before))


def test_charts_go_on_after_the_clock_was_set_back(page, floor):
    opened(page, floor, "/machines/mill-1")
    until(page, "!!document.querySelector('#c-displacement').data")
    before, drawn = floor.publisher.newest["mill-1"], "document.querySelector('#c-displacement')"
    for x_um, ahead in ((77.7, 3600.0), (88.8, 0.0)):
        ends = f"{drawn}.data.some((one) => one.y.at(-1) === {x_um})"
        moment, displacement = time.time() + ahead, np.array([1e-6 * x_um, 0.0])
        floor.publish(again(before, time=moment, displacement=displacement))
        until(page, ends)
    floor.publish(again(before))


def test_a_page_follows_a_model_that_has_replaced_another(page, floor):
    """One without slopes, and without a reading: the page stood still at the values before."""
    opened(page, floor, "/machines/mill-1")
    until(page, "!!document.querySelector('#c-displacement').data")
    before = floor.publisher.newest["mill-1"]
    *readings, last = before.layout.readings
    layout = replace(before.layout, lines=(), readings=tuple(readings))
    moved, few = np.array([77.7e-6, -56.7e-6]), before.readings[:-1]
    gone = {"layout": layout, "slopes": np.empty(0), "readings": few, "displacement": moved}
    floor.publish(again(before, **gone))
    until(page, "document.querySelector('#axis-x .number').textContent === '+77.7'")
    state = f"document.getElementById('reading-{last}').dataset.state"
    until(page, f"{state} === 'none'")
    floor.publish(again(before))


def test_a_page_shows_the_axes_that_only_the_new_model_has(page, floor):
    opened(page, floor, "/machines/mill-1")
    until(page, "!!document.querySelector('#c-displacement').data")
    before, told = floor.publisher.newest["mill-1"], floor.machines["mill-1"]
    layout = replace(before.layout, axes=("x", "y", "z"))
    floor.machines["mill-1"] = replace(told, layout=layout, model="anew.h5")
    moved = {"displacement": np.array([1e-6, 2e-6, 88.8e-6]), "band": np.full(3, 1e-6)}
    floor.publish(again(before, layout=layout, **moved))
    floor.drop_connections()
    until(page, "document.querySelector('#axis-z .number')?.textContent === '+88.8'")
    assert "anew.h5" in page.inner_text("#model")
    floor.machines["mill-1"] = told
    floor.publish(again(before))


def test_the_machine_in_3d_has_the_temperatures_and_pressures_of_the_estimator(page, floor):
    opened(page, floor, "/machines/mill-1")
    until(page, "!!document.querySelector('#c-pressure').data")
    told = page.request.get(f"{floor.url}/api/machines/mill-1/fields").json()
    for chart, values in (("#c-temperature", "temperature_K"), ("#c-pressure", "pressure_MPa")):
        drawn = page.evaluate(
            "(chart) => [...document.querySelector(chart).data[0].intensity]", chart
        )
        assert drawn == told[values]
    opened(page, floor, "/machines/mill-2")
    assert not page.is_visible("#scene-card")


def test_a_reading_is_shown_in_its_own_unit(page, floor):
    """A feed in mm/min was one of "1", as if it had no unit."""
    opened(page, floor, "/machines/mill-1")
    units = [name for name, own in UNITS.items() if own.quantity != "time"]
    keys = [f"y_axis_{unit}" for unit in units]
    found = page.evaluate("(keys) => keys.map((key) => [unitOf(key), bare(key)])", keys)
    assert found == [[unit, "y axis"] for unit in units]


def test_a_sensor_that_is_missing_or_distrusted_is_named(page, floor):
    opened(page, floor, "/machines/mill-10")
    assert page.inner_text("#word").lower() == "uncertain"
    assert "T2: no reading" in page.inner_text("#reasons")
    assert "missing" in page.inner_text("#reading-T2_K")
    assert "distrusted" in page.inner_text("#reading-T1_K")
    assert "used" in page.inner_text("#reading-s_K")
    until(page, "document.querySelector('#reading-T1_K .residual').textContent === '+5.25'")
    page.wait_for_selector("#events li time")
    assert "T1 is distrusted" in page.inner_text("#events")


def test_the_handshake_shows_whether_the_control_takes_part(page, floor):
    opened(page, floor, "/machines/mill-1")
    until(page, "document.querySelectorAll('#handshake dd').length === 6")
    assert page.locator("#handshake dd").all_inner_texts() == [
        "▲ the control acknowledges other offsets", "yes", "17, changed now", "−12.3 µm", "–",
        "+38.0 µm/m",
    ]  # fmt: skip
    opened(page, floor, "/machines/mill-2")
    assert not page.is_visible("#handshake-card")


def test_the_handshake_follows_offsets_that_have_other_axes(page, floor):
    opened(page, floor, "/machines/mill-1")
    until(page, "document.querySelectorAll('#handshake dt').length > 0")
    said = page.request.get(f"{floor.url}/api/machines/mill-1/handshake").json()
    other = said | {"acknowledged_um": {"X": 1.0, "Z": 7.0}, "acknowledged_slopes_um_per_m": {}}
    page.route("**/handshake", lambda route: route.fulfill(json=other))
    until(page, "document.querySelector('#handshake').innerText.includes('Acknowledged Z')")
    text = page.inner_text("#handshake")
    assert "Acknowledged Y" not in text
    assert "+7.0 µm" in text


def test_a_machine_that_is_silent_is_bad_and_says_how_old_its_value_is(page, floor):
    opened(page, floor, "/machines/mill-2")
    assert page.inner_text("#word").lower() == "bad"
    assert "no samples arrive" in page.inner_text("#reasons")


@pytest.mark.parametrize("path", ["/", "/machines/mill-1", "/machines/mill-10"])
def test_on_a_phone_nothing_stands_beside_the_page(page, floor, path):
    page.set_viewport_size(PHONE)
    opened(page, floor, path)
    page.wait_for_timeout(300)
    width = page.evaluate("document.documentElement.scrollWidth")
    assert width <= PHONE["width"]
    values = "[...document.querySelectorAll('.tile-axis')]"
    assert page.evaluate(f"{values}.every(one => one.scrollWidth <= one.clientWidth)")


def test_light_and_dark_follow_the_system_until_somebody_chooses(page, floor):
    def background():
        return page.evaluate("getComputedStyle(document.body).backgroundColor")

    page.emulate_media(color_scheme="light")
    opened(page, floor, "/")
    light = background()
    page.emulate_media(color_scheme="dark")
    dark = background()
    assert light != dark
    page.click("#theme")
    assert background() == light
    page.reload()
    assert background() == light
    page.click("#theme")
    page.emulate_media(color_scheme="light")
    assert background() == dark


def test_every_control_can_be_reached_by_keyboard_and_has_a_name(page, floor):
    opened(page, floor, "/machines/mill-1")
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, a, input, [role=img]")].filter((one) =>
             !one.textContent.trim() && !one.getAttribute("aria-label") && !one.labels?.length)
             .map((one) => one.outerHTML)"""
    )
    assert nameless == []
    seen = set()
    for _ in range(12):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("document.activeElement.textContent.trim()"))
    assert {"‹ All", "Log out", "15 min"} <= seen
    assert page.get_attribute("#status [aria-live]", "aria-live") == "polite"


def test_when_the_stream_breaks_the_page_says_so_and_recovers(page, floor):
    opened(page, floor, "/machines/mill-1")
    page.context.set_offline(True)
    floor.drop_connections()
    page.wait_for_selector("#line[data-state=lost]")
    assert page.inner_text("#word").lower() == "no connection"
    assert "old" in page.inner_text("#reasons")
    assert page.evaluate("document.body.classList.contains('stale')")
    page.context.set_offline(False)
    page.wait_for_selector("#line[data-state=live]", timeout=20_000)
    assert page.inner_text("#word").lower() == "good"


def test_a_line_that_falls_silent_is_no_live_line(page, floor):
    """Without so much as a beat the values are old, whatever the socket says."""
    page.route(
        "**/api/stream*",
        lambda route: route.fulfill(
            content_type="text/event-stream",
            body='event: news\ndata: {"now_s": 1.0, "publications": []}\n\nretry: 60000\n\n',
        ),
    )
    page.goto(f"{floor.url}/")
    page.wait_for_selector("#line[data-state=lost]")


def test_nothing_comes_from_elsewhere_and_no_script_stands_in_a_page(page, floor):
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    opened(page, floor, "/machines/mill-1")
    assert all(url.startswith((floor.url, "data:", "blob:")) for url in asked)
    assert page.evaluate("document.querySelectorAll('script:not([src])').length") == 0
    blocked = page.evaluate(
        """() => new Promise((done) => setTimeout(() => {
             try { done(eval("1")) } catch { done("refused") }
           }))"""
    )
    assert blocked == "refused"
