"""Set-up of a machine from a case; the only place where its units are converted to SI."""
