"""The paper's estimator: fictitious contact heat sources (Figure 5)."""
