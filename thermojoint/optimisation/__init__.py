"""Values of a case that serve a purpose best: figures to minimise, limits to hold."""
