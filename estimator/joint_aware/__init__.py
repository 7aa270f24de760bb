"""The joint-aware estimator: the machine's reduced physics, corrected by measured temperatures."""
