"""Bench recordings with a hidden effect, to test whether a diagnosis names it.

The effects here are written in other mathematical forms than those of `pneutac_sim.effects`, and never import
them: a diagnosis that recognises only its own formulas must fail on these recordings.
"""
