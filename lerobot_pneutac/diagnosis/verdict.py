"""The five verdicts.

adequate            nothing but noise is left
missing_effect      what was found explains all but noise, holds in the whole recording, and nothing beats it
insufficient_form   what was found explains most of the avoidable error, but not all that could be
unknown_effect      most of it is explained by nothing that was found; an equation found stands in for it
ambiguous           this recording cannot tell
"""

from dataclasses import dataclass, field

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T


@dataclass
class Evidence:
    """What the verdict rests on.

    Attributes:
        poor: whether the recording is too poor for any claim, see `too_few`.
        before: held-out error over the noise: the best of the twin as it is, re-fitted, and a constant; None
            where the noise cannot be determined.
        after: the same with what was found.
        selected: effects and laws found, the most important first.
        removed: share of the avoidable error that they remove together.
        at_bound: constants of what was found that stopped at a bound.
        cancelling: laws each of which moves the device by more than it travels, so that others take it back.
        near_miss: effects that helped, but not for sure.
        left_to_black_box: share of what is left that a black box removes.
        forward: whether it holds for the later part when fitted to the earlier one.
        interval: 95 % interval of `after`, by resampling the blocks of the test part.
        later: error over noise of the later part, of the model fitted to the earlier part; None where there is
            no later part of the same conditions.
        agreed: share of split seeds that chose the same.
        noise_known: whether the noise was declared or measured by repeats.
        explained: share of all that the device does that the model predicts, effects of the twin included; of
            gels.
    """

    before: float | None
    after: float | None
    selected: list[str]
    removed: float
    poor: bool = False
    at_bound: list[str] = field(default_factory=list)
    cancelling: list[str] = field(default_factory=list)
    near_miss: list[str] = field(default_factory=list)
    left_to_black_box: float = 0.0
    forward: bool = True
    interval: tuple[float, float] | None = None
    later: float | None = None
    agreed: float = 1.0
    noise_known: bool = True
    explained: float = 0.0

    @property
    def is_noise(self) -> bool:
        """Whether what is left is called noise, wherever it is spoken of."""
        return self.after is not None and self.after <= T.NOISE

    @property
    def at_noise(self) -> bool:
        """Whether the error before is noise already, so that nothing can be named.

        Where the noise is unknown, so is what could be avoided: a small fall of the error names nothing.
        """
        if self.before is None:
            return self.removed < T.MOST
        return self.before <= (T.NOISE if self.removed < T.MOST else T.AS_IS_NOISE)

    @property
    def unfinished(self) -> bool:
        """Whether a black box still finds much in what is left, where that is more than noise."""
        much = not self.noise_known or not self.is_noise
        return much and self.left_to_black_box > T.UNFINISHED

    @property
    def objections(self) -> list[str]:
        """Why what was found may not be called the missing effect, one phrase each."""
        out = []
        if self.noise_known and self.after is not None and self.after > T.CLOSE:
            out.append(f"the error stays at {self.after:.2g} times the noise")
        if not self.noise_known and self.unfinished:
            out.append("the noise is not known")
        if self.unfinished:
            out.append(f"a black box still removes {100 * self.left_to_black_box:.0f} % of what is left")
        if not self.forward:
            out.append("fitted to the earlier part, it does not hold in the later one")
        if self.agreed < T.AGREED:
            out.append(f"only {100 * self.agreed:.0f} % of the splits chose it")
        if self.at_bound:
            out.append(f"{', '.join(self.at_bound)} stopped at a bound")
        if self.cancelling:
            laws = " and ".join(self.cancelling)
            out.append(f"{laws} would alone move it by more than it travels, and cancel with the rest")
        return out


def too_few(samples: int, units: int, few_samples: int = T.FEW_SAMPLES) -> bool:
    """Whether a recording is too short for any claim, by `diagnose` and `add` alike.

    Args:
        samples: to fit.
        units: held-out pieces of time, or photographs.
        few_samples: below which nothing can be claimed; a photograph is worth many rows.
    """
    return samples < few_samples or units < T.FEW_UNITS


def decide(e: Evidence) -> str:
    if e.poor:
        return "ambiguous"
    unknown = "insufficient_form" if e.explained >= T.MOST else "unknown_effect"
    if not e.selected:
        if e.is_noise:
            return "adequate"
        if e.near_miss:
            return "ambiguous"
        return unknown if e.noise_known or e.unfinished else "adequate"
    if e.removed < T.MOST and not e.is_noise:
        return unknown
    return "insufficient_form" if e.objections else "missing_effect"


# Constant, per unit of: log of error over noise, log odds of the share, verdict that the form suffices.
WEIGHTS = (-0.86, -1.76, 0.35, 2.28)


def calibrated_confidence(error_over_noise: float, share: float, suffices: bool) -> float:
    """Probability that the headline is the device's physics.

    Args:
        error_over_noise: on test blocks, with what was found.
        share: of the draws of blocks in which it beats the other models in the running.
        suffices: whether the verdict says that nothing of weight is left.
    """
    return float(1 / (1 + np.exp(-(np.array(WEIGHTS) @ features(error_over_noise, share, suffices)))))


def features(error_over_noise, share, suffices) -> np.ndarray:
    """(4, ...) what the weights are of, from numbers or arrays."""
    odds = np.log((np.asarray(share) + T.EVEN) / (1 - np.asarray(share) + T.EVEN))
    error = np.log(np.maximum(error_over_noise, 1.0))
    return np.stack(np.broadcast_arrays(1.0, error, odds, np.asarray(suffices, float)))
