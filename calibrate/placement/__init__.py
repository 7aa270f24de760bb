"""Which probes a calibration or an estimator reads."""
