"""Is what is left just noise? A limit by parametric bootstrap: the model is taken as true and recorded again.

Each draw puts fresh noise on the model's own prediction, estimates the noise floor from that recording in the
same way, and takes the ratio of held-out error to floor. Nineteen of twenty draws stay below the limit.
"""

import numpy as np

from pneutac_datasets.recording.noise import headline, noise_floor
from pneutac_datasets.recording.recording import Recording

DRAWS = 60
TOLERANCE = 1.10  # the floor itself is known to some percent only, and nobody cares for a leftover that small


def noise_limit(
    recording: Recording,
    residual: np.ndarray,
    mask: np.ndarray,
    sigma: np.ndarray,
    count: int,
    seed: int,
) -> float:
    """Largest ratio of held-out error to noise floor that noise alone explains, at 5 %.

    Args:
        recording: gives the headline columns and the program.
        residual: (n, k) of the model that is put to the test.
        mask: (n,) held-out samples.
        sigma: (k,) noise of each headline column.
        count: free parameters; they cost a little on samples that they were not fitted to.
        seed: of the noise.

    Returns:
        The limit, at least `TOLERANCE`.
    """
    columns, _ = headline(recording)
    truth = recording.samples[columns].to_numpy(float) - residual
    train = max(int((~mask).sum()), 1)
    rng = np.random.default_rng([seed, 11])
    again = Recording(recording.folder, recording.meta, recording.samples.copy(), recording.device)
    ratio = np.empty(DRAWS)
    for i in range(DRAWS):
        noise = sigma * rng.normal(size=truth.shape)
        again.samples[columns] = truth + noise
        mse = float((noise[mask] ** 2).sum(1).mean()) * (1 + count / train)
        ratio[i] = np.sqrt(mse) / max(noise_floor(again).value, 1e-12)
    return float(max(np.quantile(ratio, 0.95), TOLERANCE))
