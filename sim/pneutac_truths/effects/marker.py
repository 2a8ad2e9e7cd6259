"""Faults between the device and the log of the tip: none of them is physics of the device.

Faults of the pressure gauge: the air itself is as it is.
"""

from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_truths.effects.air import lag
from pneutac_truths.effects.table import effect
from pneutac_truths.world import Seen, World, seconds

marker = partial(effect, "marker", physics=False)
gauge = partial(effect, "gauge", physics=False)


@marker(size=(0.02, 3.0))
def tracker_lowpass(w: World, seen: Seen, size: float) -> None:
    """The tracker smooths the marker's path.

    `size`: time constant, s; each trial starts settled. Source: Welch and Foxlin, IEEE CG&A 22 (2002) 24;
    OptiTrack Motive manual (smoothing).
    """
    seen.path = np.concatenate([lag(np.ascontiguousarray(p), size) for p in seen.trials(seen.path)])


@marker(size=(0.008, 0.8))
def tracker_latency(w: World, seen: Seen, size: float) -> None:
    """The tracker's samples come late.

    `size`: delay, s. Source: Welch and Foxlin, IEEE CG&A 22 (2002) 24.
    """
    k = seconds(size)
    seen.path = np.concatenate([np.vstack([np.tile(p[:1], (k, 1)), p[:-k]]) for p in seen.trials(seen.path)])


@marker(size=(0.01, 1.0))
def clock_jitter(w: World, seen: Seen, size: float) -> None:
    """Samples are taken off their stamps: the clocks of camera and log wander against each other.

    `size`: standard deviation of a slow wander, s, to which a quick jitter of a quarter is added. Source:
    Mills, Computer Network Time Synchronization (2011); Furgale, Rehder and Siegwart, IROS (2013).
    """
    rng = w.draws("clock_jitter")
    n = len(w.plan.rows)
    slow = np.zeros(n)
    keep = np.exp(-w.plan.row_s / 3.0)
    for i, x in enumerate(rng.normal(0, 1, n)):
        slow[i] = keep * slow[i - 1] + np.sqrt(1 - keep**2) * x if i else x
    seen.late_s = seen.late_s + size * (slow + 0.25 * rng.normal(0, 1, n))


@marker(size=(0.3, 15.0))
def marker_slip(w: World, seen: Seen, size: float) -> None:
    """The marker slips once on the body and stays where it is.

    `size`: slip, mm, at a moment between a quarter and three quarters of the recording. Source: Chiari et
    al., Gait & Posture 21 (2005) 197 (artefacts of markers).
    """
    rng = w.draws("marker_slip")
    n = len(seen.tips)
    way = rng.normal(size=3)
    seen.tips[int(n * rng.uniform(0.25, 0.75)) :] += size * way / np.linalg.norm(way)


@marker(per_minute=(1.5, 5.0), size=(2.0, 80.0))
def tracker_outliers(w: World, seen: Seen, per_minute: float, size: float) -> None:
    """The tracker takes something else for the marker for moments.

    `size`: typical distance, mm; each lasts 1 to 4 samples. Source: Huber, Robust Statistics (1981) ch. 1;
    Hampel et al., Robust Statistics (1986).
    """
    rng = w.draws("tracker_outliers")
    n = len(seen.tips)
    for at in rng.integers(0, n - 4, max(2, round(per_minute * n * w.plan.row_s / 60))):
        seen.tips[at : at + rng.integers(1, 5)] += rng.normal(0, size / np.sqrt(3), 3)


@marker(size=(0.005, 0.25))
def tracker_crosstalk(w: World, seen: Seen, size: float) -> None:
    """The tracker's axes are not square: one leaks into another.

    `size`: share of z that shows in y, and half of it of x in z. Source: Zhang, IEEE T. PAMI 22 (2000) 1330
    (skew); Hartley and Zisserman, Multiple View Geometry (2004).
    """
    seen.tips = seen.tips @ np.array([[1, 0, -size / 2], [0, 1, 0], [0, size, 1]])
    seen.tips[:, 2] += size / 2 * w.body.length_mm  # calibrated on the straight device


@marker(size=(0.005, 0.6))
def lens_distortion(w: World, seen: Seen, size: float) -> None:
    """The lens bends straight lines and its calibration leaves some of it.

    `size`: share by which a length's distance from the image's middle is off. Source: Brown, Photogrammetric
    Engineering 37 (1971) 855.
    """
    middle = np.array([0.6, 0, 0.4]) * w.body.length_mm
    away = seen.tips - middle
    far2 = (away[:, [0, 2]] ** 2).sum(1, keepdims=True) / w.body.length_mm**2
    seen.tips = seen.tips + size * far2 * away * np.array([1, 0, 1])


@marker(size=(0.004, 0.2))
def mount_knock(w: World, seen: Seen, size: float) -> None:
    """Someone knocks the mount: from then on the whole device points elsewhere.

    `size`: turn, rad, at a moment between a third and two thirds of the recording. Source: Chiari et al.,
    Gait & Posture 21 (2005) 197.
    """
    rng = w.draws("mount_knock")
    n = len(seen.tips)
    way = rng.normal(size=3) * [0.3, 1, 1]
    at = int(n * rng.uniform(0.33, 0.67))
    seen.tips[at:] = Rotation.from_rotvec(size * way / np.linalg.norm(way)).apply(seen.tips[at:])


@marker(size=(0.01, 0.6))
def mount_turned(w: World, seen: Seen, size: float) -> None:
    """The device is taken off between two sessions of the recording and mounted turned about its axis.

    `size`: turn about the axis, rad, from a trial in the second half on. Source: Chiari et al., Gait &
    Posture 21 (2005) 197 (remounting).
    """
    start = w.draws("mount_turned").integers(len(w.plan.starts) // 2, max(2, 3 * len(w.plan.starts) // 4))
    after = w.plan.trial[w.plan.rows] >= start
    seen.tips[after] = Rotation.from_rotvec([size, 0, 0]).apply(seen.tips[after])


@marker(per_minute=(5.0, 12.0), size=(0.06, 4.0))
def tracker_freezes(w: World, seen: Seen, per_minute: float, size: float) -> None:
    """The tracker loses the marker for moments, mostly in motion, and repeats the last position.

    `size`: mean length of a freeze, s. Source: OptiTrack Motive manual (gap filling); Welch and Foxlin, IEEE
    CG&A 22 (2002) 24.
    """
    rng = w.draws("tracker_freezes")
    n = len(seen.tips)
    trial = w.plan.trial[w.plan.rows]
    k = round(per_minute * n * w.plan.row_s / 60)
    speed = np.linalg.norm(np.diff(seen.tips, axis=0, append=seen.tips[-1:]), axis=1)
    chance = speed + 0.2 * speed.mean() + 1e-9
    starts = rng.choice(n, k, p=chance / chance.sum())
    for at, length in zip(starts, rng.uniform(0.3, 1.7, k) * size / w.plan.row_s, strict=True):
        rows = np.arange(at, min(at + 1 + round(length), n))
        seen.tips[rows[trial[rows] == trial[at]]] = seen.tips[at]
        seen.frozen[rows[trial[rows] == trial[at]][1:]] = True


@marker(minutes=(1.0, 6.0), size=(0.004, 0.15))
def camera_warm_up(w: World, seen: Seen, minutes: float, size: float) -> None:
    """The camera warms and its scale drifts.

    `size`: share by which lengths are off in the end; the scale is that of the cold camera. Source:
    Podbreznik and Potočnik, Machine Vision and Applications 23 (2012): camera and temperature.
    """
    t = w.time_s[w.plan.rows]
    seen.tips = seen.tips * (1 + size * (1 - np.exp(-t / (60 * minutes))))[:, None]


@gauge(size=(0.02, 0.5))
def gauge_clipping(w: World, read: np.ndarray, size: float) -> np.ndarray:
    """The gauge's range ends below the top pressure.

    `size`: share of the top pressure that it cannot show. Source: Doebelin, Measurement Systems (2003) ch. 6.
    """
    return np.minimum(read, 1 - size)


@gauge(size=(0.01, 0.35))
def gauge_quantised(w: World, read: np.ndarray, size: float) -> np.ndarray:
    """The gauge knows few steps.

    `size`: one step, share of the top pressure. Source: Widrow and Kollar, Quantization Noise (2008).
    """
    return np.round(read / size) * size


@gauge(dead_share=(0.2, 0.6), size=(0.01, 2.0))
def gauge_late(w: World, read: np.ndarray, dead_share: float, size: float) -> np.ndarray:
    """The gauge filters and sends its readings late.

    `size`: delay and time constant together, s; `dead_share` of it pure delay. Source: Bergh and Tijdeman,
    NLR-TR F.238 (1965) (tube and gauge); Doebelin, Measurement Systems (2003).
    """
    slow = lag(np.ascontiguousarray(read), size * (1 - dead_share))
    k = seconds(size * dead_share)
    return np.concatenate([np.tile(slow[:1], (k, 1)), slow[:-k]])


@gauge(minutes=(2.0, 10.0), size=(0.01, 0.4))
def gauge_drifting(w: World, read: np.ndarray, minutes: float, size: float) -> np.ndarray:
    """The gauge's zero drifts.

    `size`: share of the top pressure by which it is off in the end. Source: Doebelin, Measurement Systems
    (2003) ch. 6 (zero shift of piezoresistive cells).
    """
    return read + _uneven(read, size) * (1 - np.exp(-w.time_s / (60 * minutes)))[:, None]


@gauge(size=(0.01, 0.25))
def gauge_span(w: World, read: np.ndarray, size: float) -> np.ndarray:
    """The gauge's scale is off.

    `size`: share by which it reads too high. Source: Doebelin, Measurement Systems (2003) ch. 2 (span error).
    """
    return read * (1 + _uneven(read, size))


def _uneven(read: np.ndarray, size: float) -> np.ndarray:
    return size * np.array([1.0, -0.5, 0.3])[: read.shape[1]]
