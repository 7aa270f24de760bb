"""The whole chain for several friction coefficients: where the paper's scheme works, and where not.

For each coefficient: simulate, place, calibrate, validate from temperatures alone, exactly as
`thermojoint reproduce` does, and print the errors of the linear estimator, of the scheme with the
deformation models calibrated to steps (as in the paper) and to estimated strengths (ours), and of
the blocks of Figure 5 driven by true signals.

    python benchmarks/friction_study.py            # about 1 minute per coefficient
"""

from __future__ import annotations

import argparse
from importlib.resources import files
from pathlib import Path

from rich.console import Console

from calibrate import chain
from estimator.fchs import judging as judge
from fesim.case.schema import read_case
from thermojoint.console import show_blocks, show_schemes, show_validation
from thermojoint.paper import inputs
from thermojoint.paper.summary import compare_schemes

COEFFICIENTS = (0.2, 0.6, 10.0)


def main() -> None:
    """Run the chain for each coefficient and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("friction", nargs="*", type=float, default=COEFFICIENTS)
    parser.add_argument("--blocks", action="store_true", help="print the block errors, too")
    options = parser.parse_args()
    reference = read_case(Path(str(files("thermojoint").joinpath("cases/equal_heights.toml"))))
    console = Console(width=110)
    for friction in options.friction:
        knee = reference.joints["knee"].model_copy(update={"friction_coefficient": friction})
        case = reference.model_copy(update={"joints": {"knee": knee}})
        responses = inputs.simulate_inputs(case, inputs.CALIBRATION | inputs.VALIDATION)
        base = responses["step-1.0"]
        others = {0.5: responses["step-0.5"], 2.0: responses["step-2.0"]}
        calibrated = chain.calibrate_responses(base, others)
        judged = {name: responses[name] for name in inputs.VALIDATION}
        found = judge.validate_model(calibrated.model, base, judged, noisy=["triangle"])
        console.print(f"\nfriction {friction:g}", style="bold")
        console.print(str(calibrated.placement))
        show_validation(console, found.rows)
        show_schemes(console, compare_schemes(found.rows, found.as_printed, found.vectors))
        if options.blocks:
            show_blocks(console, found.blocks)


if __name__ == "__main__":
    main()
