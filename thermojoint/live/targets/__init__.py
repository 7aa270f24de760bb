"""Controls that receive the offsets in their own format."""
