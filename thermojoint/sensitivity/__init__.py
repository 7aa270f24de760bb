"""How a simulated machine depends on the values of its case: derivatives, screening, variances."""
