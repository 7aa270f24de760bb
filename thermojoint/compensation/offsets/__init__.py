"""From estimates to the offsets that a control receives."""
