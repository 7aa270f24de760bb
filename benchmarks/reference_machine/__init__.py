"""Which machine the paper calculated: what it does not print is varied, what it prints judges."""
