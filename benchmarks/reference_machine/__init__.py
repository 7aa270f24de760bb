"""The machine of the paper: unprinted parameters are varied, printed results are compared."""
