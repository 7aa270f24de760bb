"""How fast the product is, every figure a ratio of two things measured in the same run."""
