"""The dashboard's picture in the docs: the simulated working day of the reference machine.

Reads the joint-aware model and the day that `thermojoint reproduce` leaves in its folder, serves
them as a service would at the last moment of the day at which the estimate is good, and takes a
picture of the page. The server is the one of the tests. Needs Chromium; from the root of a clone:

    PYTHONPATH=tests/helpers python -m benchmarks.dashboard_picture results    # about ten seconds
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

from dashboard_server import TOKEN, about, keep, layout_of, published, serving
from playwright.sync_api import ViewportSize, sync_playwright

from benchmarks.study import options_of
from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import read_observer
from estimator.joint_aware.readings import samples_in
from thermojoint.artefacts.response import read_response
from thermojoint.live.publication import Publication, Quality

MACHINE, OFFSETS = "mill-1", ("X", "Y")
#: Long enough to show something, s. Later the day is warmer than what was calibrated.
LEAST = 0.75 * 3600.0
WINDOW: ViewportSize = {"width": 1280, "height": 1060}


def day(folder: Path) -> tuple[JointAware, list[Publication]]:
    """Return the estimator and what a service would publish until the last good sample."""
    estimator = JointAware(read_observer(folder / "joint_aware.h5"))
    response = read_response(folder / "responses" / "day.nc")
    samples = list(samples_in(response, estimator.model.sensors))
    estimates = [one for _, one in follow(estimator, samples, estimator.initial_state())]
    layout = layout_of(estimator, OFFSETS)
    rows = published(MACHINE, layout, estimates, samples, 0.0)
    last = max(k for k, row in enumerate(rows) if row.quality is Quality.GOOD)
    if samples[last][0] < LEAST:
        raise SystemExit(f"the last good estimate is at {samples[last][0] / 3600.0:.1f} h")
    now = time.time() - samples[last][0]
    return estimator, published(MACHINE, layout, estimates, samples, now)[: last + 1]


def main() -> None:
    """Write the picture."""
    parser = options_of(__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images/dashboard.png"))
    given = parser.parse_args()
    estimator, rows = day(given.results)
    with tempfile.TemporaryDirectory() as name, sync_playwright() as browsers:
        folder = Path(name)
        archive = keep(folder / "store.db", [rows])
        machines = {MACHINE: about(estimator, rows[0].layout, rows[0].time)}
        with serving(folder, archive, machines, rows[-1:]) as server:
            browser = browsers.chromium.launch(executable_path=shutil.which("chromium"))
            context = browser.new_context(viewport=WINDOW)
            context.request.post(f"{server.url}/login", form={"token": TOKEN})
            page = context.new_page()
            page.goto(f"{server.url}/machines/{MACHINE}")
            page.wait_for_selector("#line[data-state=live]")
            page.get_by_text("1 h", exact=True).click()
            page.wait_for_timeout(2000)
            page.screenshot(path=given.out)
            browser.close()


if __name__ == "__main__":
    main()
