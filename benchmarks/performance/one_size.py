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

from benchmarks.performance.cases import (
    coarse_case,
    reference_case,
    reference_machine,
    with_contacts,
    with_elements,
)
from benchmarks.performance.timing import seconds
from fesim.case.schema import step_count
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate

#: Bytes in the unit of ru_maxrss.
MAXRSS_UNIT = 1 if sys.platform == "darwin" else 1024


def main() -> None:
    """Measure one size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--elements", type=float, default=50.0, help="mm")
    parser.add_argument("--joint-elements", type=float, help="mm; default: as the others")
    parser.add_argument("--contacts", type=int, nargs=2, default=(9, 3), help="along and across")
    parser.add_argument("--candidates", action="store_true", help="with all possible sensors")
    given = parser.parse_args()
    case = reference_machine() if given.candidates else reference_case()
    case = with_elements(case, given.elements, given.joint_elements)
    case = with_contacts(case, *given.contacts)
    # Libraries are loaded and machine code is made before anything is timed.
    coarse = coarse_case()
    simulate(coarse, setup=set_up(coarse))
    found: list[Setup] = []
    taken = seconds(lambda: found.append(set_up(case)))
    # Set-up's peak: the march adds nothing of its size.
    peak = peak_memory()
    (setup,) = found
    steps = step_count(case.march)
    march = median(seconds(lambda: simulate(case, setup=setup)) for _ in range(3))
    print(
        json.dumps(
            {
                "unknowns": setup.spaces.displacement_size,
                "temperatures": int(setup.spaces.heat.N),
                "contacts": setup.machine.contacts,
                "modes": 0 if setup.modes is None else int(setup.modes.rates.size),
                "setup": taken,
                "memory": peak,
                "step": 1e3 * march / steps,
            }
        )
    )


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
