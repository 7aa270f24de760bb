"""Set-up and march of one size in a process of its own, so that its peak memory is its own.

Run by `benchmarks.performance.scaling`; prints one line of JSON.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from benchmarks.performance.cases import (
    coarse_case,
    reference_case,
    reference_machine,
    with_contacts,
    with_elements,
)
from benchmarks.performance.pillar import pillar_case
from benchmarks.performance.plain_set_up import plain_set_up
from benchmarks.performance.timing import seconds
from benchmarks.study import options_of
from fesim.case.schema import Case, step_count
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate

#: A march with more contact elements is run once.
FEW = 1_000
#: Bytes in the unit of ru_maxrss.
MAXRSS_UNIT = 1 if sys.platform == "darwin" else 1024


def main() -> None:
    """Measure one size."""
    parser = options_of(__doc__)
    parser.add_argument("--elements", type=float, default=50.0, help="mm")
    parser.add_argument("--joint-elements", type=float, help="mm; default: as the others")
    parser.add_argument("--contacts", type=int, nargs=2, default=(9, 3), help="along and across")
    parser.add_argument("--candidates", action="store_true", help="with all possible sensors")
    parser.add_argument(
        "--pillar",
        type=int,
        nargs=3,
        help="in place of the milling machine: contact elements along and across, elements",
    )
    parser.add_argument("--plain", action="store_true", help="set up as `plain_set_up` does")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        found = sizes(_case(given, Path(folder)), given.plain)
    print(json.dumps(found))


def _case(given: argparse.Namespace, folder: Path) -> Case:
    if given.pillar:
        return pillar_case(folder, *given.pillar)
    case = reference_machine() if given.candidates else reference_case()
    case = with_elements(case, given.elements, given.joint_elements)
    return with_contacts(case, *given.contacts)


def sizes(case: Case, plainly: bool) -> dict[str, float]:
    """Set up and march one size; what it was, s, GB and ms as `scaling.Size` has them."""
    # Libraries are loaded and machine code is made before anything is timed.
    coarse = coarse_case()
    simulate(coarse, setup=set_up(coarse))
    if plainly:
        taken = seconds(lambda: plain_set_up(case))
        known = dict.fromkeys(("unknowns", "temperatures", "contacts", "modes"), 0)
        return known | {"setup": taken, "memory": peak_memory(), "step": 0.0}
    found: list[Setup] = []
    taken = seconds(lambda: found.append(set_up(case)))
    # Set-up's peak: the march adds nothing of its size.
    peak = peak_memory()
    (setup,) = found
    steps = step_count(case.march)
    repeats = 3 if setup.machine.contact.count < FEW else 1
    march = median(seconds(lambda: simulate(case, setup=setup)) for _ in range(repeats))
    return {
        "unknowns": setup.spaces.displacement_size,
        "temperatures": int(setup.spaces.heat.N),
        "contacts": setup.machine.contact.count,
        "modes": 0 if setup.modes is None else int(setup.modes.rates.size),
        "setup": taken,
        "memory": peak,
        "step": 1e3 * march / steps,
    }


def peak_memory(status: Path = Path("/proc/self/status")) -> float:
    """Peak memory of this process, GB.

    Where the system has no /proc it is ru_maxrss, which on Linux begins with that of the parent.
    """
    if status.exists():
        (line,) = (one for one in status.read_text("ascii").splitlines() if one.startswith("VmHWM"))
        return 1.024e-6 * float(line.split()[1])
    return 1e-9 * MAXRSS_UNIT * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main()
