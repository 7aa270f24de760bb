"""What is done about the displacement that was estimated: offsets of the axes, and heat."""
