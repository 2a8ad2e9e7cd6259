"""Calibrates a finger or an arm to photographs: silhouettes first, then whole pictures of material points.

    parameters = body_parameters(twin, pressure_range_kpa=15)
    start = coarse_fit(parameters, pressures_kpa, photographs)
    rest = Equilibria(parameters, start.x, pressures_kpa)
    objective = Objective(rest, photographs, looks)
    found = search(objective, parameters, start)
    twin = parameters.twin_at(found.x, confidence(objective, found.x).ci95)

The objective is the paper's: mean over photographs of the masked L1 difference + 2 (1 - IoU).
"""
