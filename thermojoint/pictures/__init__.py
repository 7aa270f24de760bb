"""Drawing of structures, fields and curves, as pictures and films."""
