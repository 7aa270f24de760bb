"""The estimator of a learned model: readings in, displacement out, a probing now and then."""
