"""Bodies that move along an axis during the march."""
