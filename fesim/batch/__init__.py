"""Many cases at once: the study file, the workers, and the folder that holds what they found."""
