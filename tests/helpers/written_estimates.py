"""What `estimate` writes and what `compensate` reads, of an estimator of any kind."""

import numpy as np

import thermojoint as tj
from estimator.estimate_table import header, read_estimate, row


def assert_compensate_reads_what_is_written(path, folder, name):
    """To the digits that are written; and the state goes on from its file to the last bit."""
    estimator = tj.open_estimator(path)
    assert estimator.kind == name
    state, written, said = estimator.initial_state(), [header(estimator)], []
    for k in range(3):
        values = [290.0 if "degC" in one.name else 0.01 * k for one in estimator.channels]
        state, estimate = estimator.sample(state, 60.0 * (k + 1), values)
        written.append(row(estimator, estimate))
        said.append(estimate)
    axes, rows = read_estimate([",".join(cells) for cells in written], "table")
    assert axes == tuple(axis.removesuffix("_um") for axis in estimator.axes)
    for read, one in zip(rows, said, strict=True):
        assert (read.time, read.status) == (one.time, one.words)
        np.testing.assert_allclose(read.displacement, one.displacement, rtol=1e-8, atol=1e-15)
        np.testing.assert_allclose(read.band, one.band, rtol=1e-8, atol=1e-15)
    tj.save_state(estimator, state, folder / "state.json")
    again, begun = tj.resume_estimator(path, folder / "state.json")
    assert np.array_equal(begun, state, equal_nan=True)
    assert again.kind == estimator.kind
