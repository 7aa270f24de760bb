"""Pictures: structures and fields in space, curves, films."""
