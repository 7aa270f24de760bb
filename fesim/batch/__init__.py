"""Parameter studies: study file, worker pool and results folder."""
