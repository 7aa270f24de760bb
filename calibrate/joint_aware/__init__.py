"""Responses to a joint-aware model: the fit of its physics, its filter, its bands."""
