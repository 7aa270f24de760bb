"""The front door: the command line, the chain across the packages, report and pictures."""
