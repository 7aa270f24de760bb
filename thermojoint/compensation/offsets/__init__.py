"""Axis offsets for a control, from estimates."""
