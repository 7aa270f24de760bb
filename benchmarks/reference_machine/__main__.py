"""Run the studies of the reference machine and score every machine in them.

    python -m benchmarks.reference_machine    # 505 marches, 31 condensations

Each study is a batch (docs/batch.md) with a folder of its own; stopped in any way, the same command
goes on from there. Beside each folder stand STUDY.json and STUDY.md, the scored machines.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

from benchmarks.reference_machine.table import as_json, as_markdown, scored
from benchmarks.study import options_of, write_json
from fesim.batch.study import read_study
from thermojoint.artefacts.files import write_text
from thermojoint.cli.batch_run import crew_of, run_cases

HERE = Path(__file__).parent
STUDIES = tuple(sorted(path.stem for path in HERE.glob("*.toml")))


def main(arguments: list[str] | None = None) -> None:
    """Run what is not finished, then judge all of it."""
    parser = options_of(__doc__)
    parser.add_argument("study", nargs="*", help=f"default: all of {', '.join(STUDIES)}")
    parser.add_argument("--out", type=Path, default=Path("build/reference-machine"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    for name in options.study or STUDIES:
        path, folder = HERE / f"{name}.toml", options.out / name
        study = read_study(path)
        run_cases(study, str(path), folder, partial(crew_of, options.workers, None))
        machines = list(scored(study, folder))
        table = as_markdown(machines)
        write_json(options.out / f"{name}.json", as_json(machines))
        write_text(options.out / f"{name}.md", table)
        print(f"{name}\n\n{table}")


if __name__ == "__main__":
    main()
