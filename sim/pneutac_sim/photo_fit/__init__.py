"""Calibrates a finger or an arm to photographs: silhouettes first, then whole pictures of material points.

    parameters = body_parameters(twin, pressure_range_kpa)
    start = coarse_fit(parameters, twin, pressures, photographs)
    rest = Equilibria(parameters, start, pressures)
    found = search(Objective(rest, photographs, looks), start)

The objective is the paper's: mean over photographs of the masked L1 difference + 2 (1 - IoU).
"""
