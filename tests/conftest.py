"""Fixtures that several test files share."""

import copy
import gc
import os
import signal
import tempfile
import tomllib
from importlib.resources import files
from pathlib import Path

import hypothesis
import pytest
from compiled_once import compile_once
from in_process import run
from own_process import FORKED
from short_runs import few_starts as with_few_starts
from threadpoolctl import threadpool_limits

from fesim.batch import local
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts import processes
from thermojoint.models.parameters import (
    DeformationModel,
    FictitiousSource,
    LinearModel,
    Model,
    Relaxation,
    RingModel,
    Span,
)
from thermojoint.models.regularisation import choose_regularisation

# Test processes share the cores: threads of their linear algebra would wait for each other, unless
# somebody asks for them (`make portable`). The variable is for what is loaded later and for
# processes that tests start, the call for the rest.
threadpool_limits(limits=int(os.environ.setdefault("OMP_NUM_THREADS", "1")))

# How long an example takes says something of the machine and its load, nothing of a law. In CI the
# examples are the same in every run: new ones are looked for where somebody can follow them up.
hypothesis.settings.register_profile("any machine", deadline=None, max_examples=50)
hypothesis.settings.register_profile("ci", deadline=None, max_examples=50, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "any machine")

# Where a shell started the tests in its background Ctrl-C is ignored, and with `nohup` SIGHUP, and
# so they would be in the processes that tests start and interrupt.
for ignored, usual in (
    (signal.SIGINT, signal.default_int_handler),
    (signal.SIGHUP, signal.SIG_DFL),
):
    if signal.getsignal(ignored) is signal.SIG_IGN:
        signal.signal(ignored, usual)

# No test finds what another run has left, nor leaves anything: condensations are kept for one run
# alone, and its processes share them.
if "PYTEST_XDIST_WORKER" not in os.environ:
    _KEPT = tempfile.TemporaryDirectory(prefix="thermojoint-", ignore_cleanup_errors=True)
    os.environ["THERMOJOINT_CACHE"] = _KEPT.name
compile_once()

#: What takes long begins first, so that the processes end at about the same time. The first module
#: makes the machine code of the simulator, most of a minute where none is kept; the three after
#: it need none, and two of them wait more than they compute.
FIRST = (
    "thermojoint/paper/test_study.py",
    "thermojoint/live/test_targets.py",
    "thermojoint/live/test_linuxcnc.py",
    "calibrate/learning/test_learning.py",
    "thermojoint/verification/test_verification.py",
    "thermojoint/cli/test_learning_cli.py",
    "thermojoint/live/test_live_service.py",
    "fesim/batch/test_batch.py",
    "thermojoint/live/test_dashboard.py",
    "thermojoint/setup_pages/test_setup_in_a_browser.py",
    "thermojoint/paper/test_shipped_machines.py",
    "thermojoint/optimisation/test_optimisation.py",
    "estimator/export/test_structured_text.py",
    "estimator/export/test_export_joint_aware.py",
    "fesim/march/test_adaptive.py",
    "estimator/joint_aware/test_moving_axis.py",
    "estimator/joint_aware/test_driven_axis.py",
    "estimator/joint_aware/test_unlike_the_case.py",
    "project/test_live_newcomer.py",
    "estimator/joint_aware/test_joint_aware.py",
    "thermojoint/compensation/test_closed_loop.py",
    "thermojoint/live/test_companion_models.py",
    "thermojoint/paper/test_calibration_input.py",
    "thermojoint/cli/test_outputs.py",
    "thermojoint/live/test_http.py",
    "thermojoint/cli/test_cli.py",
    "fesim/batch/test_batch_cluster.py",
    "fesim/axes/test_moving_axis.py",
    "estimator/joint_aware/test_faulty_readings.py",
    "estimator/joint_aware/test_ageing.py",
    "thermojoint/live/test_mtconnect.py",
    "thermojoint/sensitivity/test_sensitivity.py",
    "project/test_newcomer.py",
    "project/test_private_parts.py",
    "project/test_api_page.py",
    "project/test_service_account.py",
    "project/test_benchmarks.py",
    "thermojoint/cli/test_interruption.py",
    "thermojoint/cli/test_start.py",
    "thermojoint/live/test_access.py",
    "thermojoint/live/test_operation.py",
    "thermojoint/live/test_opcua_clients.py",
    "thermojoint/pictures/test_pictures.py",
    "thermojoint/standards/test_iso230_3.py",
    "thermojoint/standards/test_targets.py",
)


def pytest_sessionstart():
    gc.disable()


def pytest_collection_finish():
    """Nothing of what is loaded until here is garbage: it is not looked through again."""
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)
    gc.enable()


def pytest_collection_modifyitems(items):
    """Begin with the modules of `FIRST`; `--no-loadscope-reorder` keeps the order."""
    here, ranks = Path(__file__).parent, {name: k for k, name in enumerate(FIRST)}
    assert all((here / name).exists() for name in FIRST)
    items.sort(key=lambda item: ranks.get(str(item.path.relative_to(here)), len(FIRST)))


@pytest.fixture(scope="session", autouse=True)
def forked_workers():
    """Pools of these processes need not load the libraries; those of real commands do."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (processes, local):
            patch.setattr(module, "CONTEXT", FORKED)
        yield


@pytest.fixture(scope="module")
def few_starts():
    """For calibrations that are run for what becomes of them: their fits begin from few places."""
    with with_few_starts():
        yield


@pytest.fixture
def command(capsys):
    """Run the command line in this process; gives exit code, standard output and error."""

    def told(*arguments):
        code = run(*arguments)
        return code, *capsys.readouterr()

    return told


@pytest.fixture(scope="session")
def coarse_data():
    """The equal-heights case, coarse and one minute long, as nested dictionaries: copy to edit."""
    data = tomllib.loads(
        files("thermojoint").joinpath("cases/equal_heights.toml").read_text("utf-8")
    )
    data["structure"] = {"kind": "box_milling_machine", "element_size_mm": 100.0}
    data["march"] |= {"duration_min": 1.0, "thermal": "full"}
    data["candidates"] = []
    data["probes"] = {
        "a": {"position_mm": [575.0, 600.0, 175.0], "body": "column"},
        "b": {"position_mm": [550.0, 450.0, 125.0], "body": "column"},
        "T1": {"position_mm": [625.0, 450.0, 87.5], "body": "column"},
        "T2": {"position_mm": [625.0, 700.0, 87.5], "body": "column"},
    }
    return data


@pytest.fixture(scope="session")
def coarse_case(coarse_data):
    """The coarse case."""
    return case_from_data(coarse_data, "coarse case", Path())


@pytest.fixture(scope="session")
def coarse_setup(coarse_case):
    """Condensed once for all tests."""
    return set_up(coarse_case)


@pytest.fixture(scope="session")
def coarse_response(coarse_case, coarse_setup):
    """Its response to the reference step."""
    return simulate(coarse_case, setup=coarse_setup).response


@pytest.fixture(scope="session")
def hand_made_model(coarse_data):
    """A model with round numbers, whose sensors are the probes of the coarse case."""
    main = RingModel(K=3.372, a=3.20, alpha=0.000212, r=0.19, r0=0.12)
    near = RingModel(K=3.0, a=4.0, alpha=2e-4, r=0.10, r0=0.05)
    sources = tuple(
        FictitiousSource(
            K=near.K,
            a=near.a,
            alpha=near.alpha,
            r0=near.r0,
            strengths={0.5: -0.25, 2.0: 1.0},
            regularisation=choose_regularisation(near, 2.0),
            deformation={
                axis: DeformationModel(sign * 1e-6, 3e-6, -1e-8, 0.01, 0.004, 0.008, 2e-8, 0.02)
                for axis, sign in (("x", first), ("y", -first))
            },
        )
        for first in (1.0, 2.0)
    )
    return Model(
        linear=LinearModel(
            thermal=main,
            regularisation=choose_regularisation(main, 2.0),
            deformation={
                "x": DeformationModel(1e-6, -87e-6, -5e-8, 0.009, 0.0013, 0.01),
                "y": DeformationModel(4e-6, 66e-6, -4e-8, 0.0012, 0.0014, 0.03),
            },
            direct={
                "T1": Relaxation((0.4, 0.2), (1e-3, 4e-3)),
                "T2": Relaxation((4.0, 2.0), (1e-3, 4e-3)),
            },
        ),
        sources=sources,
        distances=((0.10, 0.30), (0.32, 0.11)),
        sensors={
            name: tuple(1e-3 * place for place in probe["position_mm"])
            for name, probe in coarse_data["probes"].items()
        },
        reference_power_W=295.0,
        span=Span(60.0, (0.0, 2.0), {"delta_T": (0.0, 8.0), "T1": (0.0, 2.0), "T2": (0.0, 12.0)}),
    )


@pytest.fixture(scope="session")
def coarse_day(coarse_data, tmp_path_factory):
    """A day of the coarse machine at 20 s: two loads, a pause, a cool-down."""
    history = tmp_path_factory.mktemp("day") / "load.csv"
    rows = "0,1.5 10000,1.5 10100,0.3 24000,0.3 24100,0 30000,0 30100,1 60000,1 60100,0"
    history.write_text("time_s,heat_input\n" + rows.replace(" ", "\n") + "\n")
    data = copy.deepcopy(coarse_data)
    data["march"] |= {"duration_min": 1440.0, "step_s": 20.0, "thermal": "reduced"}
    data["heat_input"] = {"kind": "sampled", "file": str(history)}
    return simulate(case_from_data(data, "day", Path())).response
