"""From a case to a machine ready to march: the only place where its units become SI."""
