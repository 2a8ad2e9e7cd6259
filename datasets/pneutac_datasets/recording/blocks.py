"""Cuts a recording into blocks of time and deals them into parts, stratified by condition.

Neighbouring samples carry nearly the same error, so a split by single samples would test a model on what it
was fitted to; whole blocks do not. Rare conditions (a flipped base in a tenth of the blocks) must be in each
part, else their effect is either not learned or not tested.
"""

import numpy as np
import pandas as pd

TARGET_BLOCKS = 40
EDGE = 1e-5  # of a block: rows so near its end belong to the next
LEVELS = ("temperature_c", "payload_g")  # drift within a block, so a block counts with its mean


def time_blocks(samples: pd.DataFrame) -> np.ndarray:
    """Block number (n,) of each sample: equal pieces of time within one trial, program and orientation."""
    cut = np.zeros(len(samples), bool)
    cut[0] = True
    keys = [c for c in ("program", "gravity_x", "gravity_y", "gravity_z") if c in samples]
    trial = samples["trial"].to_numpy()
    cut[1:] |= trial[1:] != trial[:-1]
    for name in keys:
        v = samples[name]
        v = np.round(v.to_numpy(float)) if name != "program" else pd.factorize(v)[0]
        change = v[1:] != v[:-1]
        if change.sum() <= len(samples) / 20:  # a label that flickers cannot bound blocks
            cut[1:] |= change
    run = np.cumsum(cut) - 1
    time = samples["time_s"].to_numpy()
    starts = np.flatnonzero(cut)
    t0 = time[starts]
    duration = np.array([time[b - 1] - time[a] for a, b in _spans(starts, len(samples))])
    target = max(duration.sum() / TARGET_BLOCKS, 1e-9)
    # An offset of the clock changes the last digits of times: what is at an edge must not depend on them.
    pieces = np.maximum(1, np.round(np.round(duration / target, 6))).astype(int)
    # a short run (one step of a trial) still gives something to both parts
    sizes = np.array([b - a for a, b in _spans(starts, len(samples))])
    pieces = np.where((pieces == 1) & (sizes >= 20), 2, pieces)
    share = (time - t0[run]) / np.maximum(duration[run], 1e-12)
    within = np.minimum((share * pieces[run] + EDGE).astype(int), pieces[run] - 1)
    return np.unique(run * (pieces.max() + 1) + within, return_inverse=True)[1]


def _spans(starts: np.ndarray, n: int):
    return zip(starts, np.r_[starts[1:], n], strict=True)


def strata(samples: pd.DataFrame, block: np.ndarray) -> np.ndarray:
    """Stratum number of each block (n_blocks,): equal program, orientation, level of temperature, load."""
    first = np.unique(block, return_index=True)[1]
    key = [np.zeros(len(first), int)]
    for name in ("program", "indenter", "role"):
        if name in samples:
            key.append(pd.factorize(samples[name].astype(str))[0][first])
    for name in ("gravity_x", "gravity_y", "gravity_z"):
        if name in samples:
            key.append(np.round(samples[name].to_numpy(float)[first]).astype(int))
    for name in LEVELS:
        if name in samples:
            v = samples[name].to_numpy(float)
            mean = np.bincount(block, v) / np.bincount(block)
            span = np.ptp(mean)
            key.append(np.minimum(2, (3 * (mean - mean.min()) / span).astype(int)) if span > 0 else key[0])
    return np.unique(np.stack(key, 1), axis=0, return_inverse=True)[1].reshape(-1)


def assign(
    samples: pd.DataFrame, block: np.ndarray, seed: int, fractions: tuple[float, ...] = (0.7, 0.3)
) -> np.ndarray:
    """Part number (n,) of each sample.

    Blocks are shuffled within their stratum and laid on one line; each part takes its share spread evenly
    along it, so a stratum with as many blocks as there are parts is in every part. Fractions are positive and
    sum to 1.
    """
    rng = np.random.default_rng(seed)
    share = np.asarray(fractions, float)
    share = share / share.sum()
    stratum = strata(samples, block)
    part = np.zeros(len(stratum), int)
    debt = np.zeros(len(share))  # what each part is owed; carried over so that single blocks are dealt fairly
    for s in rng.permutation(stratum.max() + 1):
        members = rng.permutation(np.flatnonzero(stratum == s))
        missing = set(range(len(share))) if len(members) >= len(share) else set()
        for left, b in zip(range(len(members), 0, -1), members, strict=True):
            debt += share
            options = list(missing) if len(missing) == left else range(len(share))
            part[b] = max(options, key=lambda i: debt[i])
            debt[part[b]] -= 1
            missing.discard(int(part[b]))
    if len(stratum) >= len(share):  # no part is empty where there are blocks enough
        for i in range(len(share)):
            if not (part == i).any():
                largest = np.bincount(part, minlength=len(share)).argmax()
                part[rng.choice(np.flatnonzero(part == largest))] = i
    return part[block]
