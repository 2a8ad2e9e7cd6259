"""Other people's renderers, rewritten, to be measured against: of tactile images and of a body's looks.

A tactile one is a class with a classmethod `fit(pair)` and `image(press)`, so that the gel of
`pneutac_sim.gel` and these are compared on equal terms: one rest image, one indentation image and what
pressed it. One of a body has `fit(body, positions, gradients, image, mask, camera)` and
`image(positions, gradients, camera)`. Where one image leaves a method a choice, the stronger one was taken;
each module says which, and why.
"""
