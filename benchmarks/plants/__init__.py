"""Every estimator on machines drawn at random, each calibrated from its own responses."""
