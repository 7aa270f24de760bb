"""What an estimator must beat: nothing, the linear model, and regressions on the same data."""
