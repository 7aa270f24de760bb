"""The closed loop: a marched machine, an estimator that reads it, a heater and axes that act."""
