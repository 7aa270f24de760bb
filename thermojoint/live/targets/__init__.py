"""Controls that the offsets are written into, in their own language."""
