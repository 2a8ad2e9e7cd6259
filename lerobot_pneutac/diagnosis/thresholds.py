"""Every number that decides something in a diagnosis, with its reason and its user.

An error over the noise is a ratio of root mean squares; shares and worths are of mean squares, unless stated.
The excess is a mean square error less that of the noise.
"""

# ---------------------------------------------------------------- close to the noise: error over noise

AS_IS_NOISE = 1.1  # below, nothing is looked for: its estimate is off by as much (search, verdict)
NOISE = 1.2  # below, what is left is called noise (verdict, body_search, reports, `learn`)
CLOSE = 1.5  # above, most of the squared error is the model's (verdict, body_search, bootstrap, data_breaks)

# ---------------------------------------------------------------- search

MOST_TERMS = 6  # acceptances: more terms were never right on devices with known physics (search)
BEAM = 3  # models that are grown in a round (search)
OTHER_ACTUATIONS = 4  # fitted well, where the actuation model is chosen again (search)
COARSE, FINE = 12, 6  # additions fitted roughly, and then well, in a round (search)
STOP_EXCESS = 0.06  # of the noise: with less excess the search ends (search)
WORTH_OF_EXCESS = 0.04  # of the excess: least fall that is worth a term (search)
WORTH_OF_NOISE = 0.03  # of the noise: the same where little excess is left (search, body_search)
NEEDED_OF_NOISE = 0.1  # of the noise: least fall for which a term is reported or added (search)
WORTH_OF_START = 0.005  # of the excess of the start: the same for late terms (search)
WORTH_OF_BASE = 0.05  # of the excess: least fall for which the costlier base is taken (search)
SAME_ACTUATION = 0.02  # of the error or noise: actuation models that differ by less are equal (search)
WORTH_KEEPING = 0.02  # of the excess without a term: least rise for which pruning keeps it (search)
WORTH_NAMING = (
    0.1  # the same in the finished model: what is worth less compensates for the rest (body_search)
)
ACTUATION_AGAIN = 0.5  # of the excess at the last choice of the actuation: below, it is chosen again (search)
EQUAL = 0.01  # of the excess: models that differ by less are equal, the simpler wins (search)
LOST_LAST = 0.05  # of the fall ahead of time: most that the last of these stretches may lose (search)
AHEAD = (0.4, 0.6, 0.8, 1.0)  # of the rows: stretches to be predicted from all before them (search)

# ---------------------------------------------------------------- significance and stability

DRAWS = 2000  # of the bootstrap: its 1 % quantile then rests on twenty draws (bootstrap)
SIGNIFICANCE = 0.01  # one-sided: a drop counts where it holds in 99 % of the draws (bootstrap)
POWER = 0.8  # of such recordings show a fall for which `add` says how much more to record (bootstrap)
LEAST_MORE = 0.1  # of the recording: with less more nothing is decided (base)
AVOIDABLE = 0.02  # of the noise: with less excess nothing can be reduced (bootstrap, body)
VOTES = 7  # other splits in which the choice is repeated (search)
VOTE_BLOCKS = 0.75  # of the blocks, in each of these (search)
AS_GOOD = 0.02  # of the excess: models that differ by less are rivals (search, gel)
MOST_RIVALS = 3  # that are reported (search)
MOST_OTHERS = 4  # candidates besides the final model and the twin as it is (body, design)

# ---------------------------------------------------------------- parts

FRACTIONS = (0.5, 0.25, 0.25)  # of the blocks: train, validation, test (parts)
FEW_BLOCKS = 10  # below, a third part would hold a block or two: validation is the test as well (parts)
RARE = 4  # blocks of a condition below which they are cut finer (parts)
LEAST_OF_A_KIND = 8  # blocks of each condition: one in each part may fall where nothing shows (parts)
UNITS = 16  # wanted in each held-out part: fewer say little about their own spread (parts)
LEAST_CHANGE = {"temperature_c": 1.0, "payload_g": 1e-3}  # of a condition that can be tested (body)

# ---------------------------------------------------------------- verdict

MOST = 0.5  # share of the excess that effects must remove to be the headline (verdict, gel)
UNFINISHED = 0.2  # share of the rest that a black box may remove without an objection (verdict)
BLACK_BOX_EXCESS = 0.05  # of the noise: with less excess a black box finds nothing (black_box)
AGREED = 0.5  # share of the votes below which a finding is unstable (verdict)
FEW_UNITS = 6  # held-out pieces of time below which no bootstrap means much (verdict, bootstrap)
FEW_SAMPLES = 60  # to fit, below which nothing is claimed (verdict)
CERTAIN = 0.8  # calibrated probability above which a mechanism is called certain (verdict)
NAMED = 0.5  # the same above which it is named: below, another mechanism is likelier than it (verdict)
AT_MOST_ELSEWHERE = 0.75  # the same where later rows or programs are far from the noise: of 62, 47 were right
WEAK_GAIN = 0.25  # of the mean bend per kPa: with less a device hardly bends (names)
WEAK_RANGE = 0.08  # of the range of pressure: least stretch of which that is said (names)
NOT_SHOWN = 0.1  # the same of what the measured pressure does not show: of 10, none was right (verdict)

# ---------------------------------------------------------------- parameters

AT_BOUND = 1e-3  # of a parameter's range: nearer to a bound it is at it (body, body_space, gel)
SPANS = 0.8  # of the allowed range: an interval that covers more is uninformative (base)
TIMES = 10.0  # an interval from zero to more than so many times the value is uninformative (base)
FAR = 0.3  # of a range: a fit without a fold stays so near to the whole one, where it is linear (body_model)
TRUST = 0.3  # of a range: the same for demonstrations (demonstration_fit)
CORRELATED = 8.0  # neighbouring residuals are worth one independent one (body_model)
IDLE_OF_RESIDUAL = 0.02  # an effect that moves the prediction by less of it does nothing (body_space)
IDLE_OF_NOISE = 0.02  # the same by the noise, for a finished fit (body_base, gel)

# ---------------------------------------------------------------- bodies

SAME_LEVEL = 0.005  # of the largest pressure: commands that differ by less are one (body_base)
FEW_LEVELS = 8  # pressures that hold most rows say little of those between (body_base)
MOSTLY_HELD = 0.95  # that share of the rows (body_base)
SMOOTH = 0.1  # of the largest pressure: where it changes by less from row to row no step was seen (body_base)
GAUGE_BETTER = 0.9  # of the error from the command: what a body driven by the gauge must reach (body_search)
AS_WELL = 1.1  # of the error from the command alone: what it may leave there (body_search)
RUNS_WORTH = 0.3  # of the excess that offsets of single runs must explain (body_search)
FEW_RUNS = 4  # below, the scatter of runs is not known (body_search, body_base)
PLAIN_OF_EXCESS, PLAIN_OF_NOISE = 0.01, 0.03  # the paper's profile is taken if it costs less (body_search)
FORWARD_ROWS = 0.6  # of the rows: the model is fitted to these to predict the rest (body_search)
FORWARD_FALL = 0.5  # of the fall of the error: must remain in the rest (body_search)
UNDER_PRESSURE = 0.02  # of the range: from there on a trial begins under pressure (body_space)
COLLINEAR = 0.02  # 1 - squared correlation below which a pair is not tried (body_space)
INSTANTS_AGAIN = 0.97  # of the error: instants of steps are fitted again while they help so much (body_space)
BETTER_START = 0.995  # of the error: another way for trials to begin must reach this (body_space)
GRAVITY_CHANGE = 0.1  # of g: the base is turned by so much where weight can be tested (body_base, body)
DEAF_GAUGE = 0.05  # of the command's range: a measured pressure that moves less is of no use (body_base)
WORTH_OF_CAUSE = 0.01  # of the mean square error: a cause that lowers it by less goes (fit_body, body_search)
NEARLY = 0.9  # of what a better effect removes: two forms of one mechanism, as two models of a valve (add)

# ---------------------------------------------------------------- data breaks

MOST_SLIPS = 3  # of a marker, that are corrected (data_breaks)
ONCE = 0.5  # of the excess that must go where a device is two, before and after a moment (data_breaks)
SLIP_OVER_NOISE = 4.0  # least jump (data_breaks)
SLIP_DIFFERS = 0.35  # share by which the jump and the lasting shift may differ (data_breaks)
CHANGE_ENDS = 0.08  # of the rows, at both ends: too little is before or after a change there (data_breaks)
CHANGE_AWAY, CHANGE_LESS = 0.06, 0.9  # so far away (of the rows) moments must explain less, by this share

# ---------------------------------------------------------------- gels

NEEDED = 10  # photographs for a verdict, the calibration pair's among them (gel)
APART = 24  # photographs from which a third is put aside for the report (gel)
FOLDS = 5  # of the cross-validation over photographs (gel)
PROMISE = 0.01  # of the error on the fitted photographs: least fall for which a set is judged (gel)

# ---------------------------------------------------------------- demonstrations

DEMONSTRATIONS = 5  # from which on anything can be claimed (demonstrations)
HELD_OUT = 0.3  # of the episodes (demonstrations)
WORTH_OF_LAST = 0.3  # of what the twin left of the demonstrations it was last fitted to (demonstrations)
WORTH_OF_LEFT = 0.1  # of what is left, where it was fitted to none (demonstrations)
STRENGTH_DIFFERS = 0.2  # log of imprint strength: one finger's differ by as much (demonstration_fit)
STRENGTH_ERRORS = 2.0  # standard errors, likewise (demonstration_fit)
BENCH_WEIGHT = 0.003  # of a mm^2 of free bend, to one of touch: decides what is open (demonstration_fit)
TELLS = 3.0  # standard deviations by which a motion shows a change (demonstration_motions)

# ---------------------------------------------------------------- next experiment

LITTLE_GAIN = 0.05  # nats about candidates, or share of new time, that count as none (design)
LITTLE_GAIN_CONSTANTS = 1.0  # nats about constants, likewise (design)
INDEPENDENT_S = 1.0  # a model's error hardly changes within: counts as one measurement (design)
OVERHEAD_S = 15.0  # that any program costs besides its own time (design)
HAND_S = 60.0  # that a manual change costs in addition (design)
ENOUGH_MIN = 10.0  # minutes at a usual rate, in which most effects show (pair)
ENOUGH_HOLDS, OF_RANGE = 5, 0.8  # pressures, over such a share of the range, show a straight line (fit_body)
HOLD_S = 1.5  # for which a command stands where it is held, as logged of 2 s at 5 Hz or more (fit_body)
LEVELS = 20  # of the range: held pressures that differ by less are one (fit_body)
QUICK_HZ = 50.0  # at which the measured pressure shows a dead time and a resonance (base)
LONG_HOLD_S = 120.0  # which shows creep and a leak (base)
TEMPERATURES_C = 5.0  # between two room temperatures that show an effect of warmth (base)
HOLD_ENOUGH = 0.8  # of the most that any hold leaves: the shortest such hold is proposed (design)

# ---------------------------------------------------------------- recordings

STANDS_KPA = 1e-3  # a pressure that moves by less stands (pair)
PSI_RATIO = 30.0  # bend per pressure, kappa w E / p, above which the unit is doubted (pair)
PSI_TIMES = 3.5  # times as far as the twin bends, likewise: half of what psi make (pair)
LEVEL_KPA = 0.25  # a photograph's pressure is so near to its training level (photographs)
SAME_VIEW = 0.9  # cosine from which two cameras look along one line and show the same (photographs)
