"""How good a simulated displacement is: errors of the joints, the mesh and the steps."""
