"""Error estimates of a simulated displacement: due to joints, mesh and steps."""
