"""What a gel is made of."""

# Of a gel whose twin has none: Ecoflex 00-31 with a coat of paint, about 0.1 MPa.
MODULUS = "gel_youngs_modulus_mpa"
MATERIAL = {MODULUS: 0.1, "gel_poissons_ratio": 0.46}
# Beyond these a gel is no rubber.
MODULUS_MPA, POISSONS_RATIO = (0.005, 2.0), (0.0, 0.495)
