"""An estimator from what a person has: a model, an assembled estimator, or a saved state."""

from __future__ import annotations

import json
from pathlib import Path

from estimator.fchs.estimator import Fchs
from estimator.saved_state import load_state
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.models import assembly_file
from thermojoint.models.assembly import assemble
from thermojoint.models.model_file import read_model
from thermojoint.models.parameters import Model

#: Length of a run where none is said, s.
RUN_LENGTH = 7200.0


def model_in(path: Path | str) -> Model:
    """Read the model of a model file or of an assembled estimator; raises as their readers."""
    return assembly_file.read_assembly(path).model if _is_assembly(path) else read_model(path)


def started(
    path: Path | str,
    interval: float,
    run_length: float = RUN_LENGTH,
    resume: Path | str | None = None,
) -> tuple[Fchs, Array]:
    """Return an estimator and the state to go on from.

    Parameters
    ----------
    path : Path or str
        A model, which is assembled, or an estimator that was, which is taken as it is.
    interval, run_length : float
        Nominal sampling interval and length of a run of an assembly that is made here, s.
    resume : Path or str, optional
        A saved state: the estimator is the one that saved it.

    Raises
    ------
    InputError
        A file is unusable, or the state belongs to another model.
    ConvergenceError
        The model cannot be assembled at the interval and run length.
    """
    if resume is not None:
        estimator, state = load_state(resume)
        if estimator.assembly.model.digest != model_in(path).digest:
            raise InputError(
                f"{resume}: state of another model than {path}; start afresh, or use the model it "
                "was saved with"
            )
        return estimator, state
    if _is_assembly(path):
        estimator = Fchs(assembly_file.read_assembly(path))
    else:
        estimator = Fchs(assemble(read_model(path), interval, run_length))
    return estimator, estimator.initial_state()


def _is_assembly(path: Path | str) -> bool:
    """Whether a file says that it is one; what cannot be read is left to the reader of models."""
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and content.get("schema") == assembly_file.FILE.schema
