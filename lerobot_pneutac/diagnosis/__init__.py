"""Finds the missing effect: the statistics that name it, its rivals, and the honest `unknown`."""
