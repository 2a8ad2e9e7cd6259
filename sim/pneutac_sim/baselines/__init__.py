"""Other renderers to be measured against: of tactile images, and of a body from one photograph."""

Each is a class with a `NAME`, a classmethod `fit(rest, indentation, press, px_per_mm, thickness_mm)` and
`image(press)`, so that the gel of `pneutac_sim.gel` and these are compared on equal terms: one rest image,
one indentation image and what pressed it. Where one image leaves a method a choice, the stronger one was
taken; each module says which, and why.
"""
