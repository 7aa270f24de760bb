"""The joint-aware estimator: the machine's own reduced physics, corrected by its temperatures."""
