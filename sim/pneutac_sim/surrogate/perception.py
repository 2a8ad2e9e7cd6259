"""Perception network f_m: probe grid to the displacement that the gel's material points would show.

A three-level UNet (paper, Sec. "Action and Perception Networks") learns what the gel adds to the grid d,

    f_m(d) = d + g(d) - g(0),

so that where nothing touches within the network's sight the surface rests exactly. Biases and the zeros that
pad the window show g where the gel ends. The first level works on blocks of 2 x 2 cells, as four channels,
which costs a quarter and loses nothing.
"""

import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer, whole
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.surrogate import perception_kernels as kern

FORMAT = "pneutac-gel-surrogate/1"
LAYERS = (*(f"{level}.{i}" for level in ("down1", "down2", "down3", "up2", "up1") for i in (0, 2)), "out")


class GelSurrogate:
    """A trained perception network, evaluated on one thread.

    The weights are float32, those of `gel_train.UNet.weights`, for the gel with this fingerprint.
    `deepest_mm` is the largest value of a probe grid and `largest_share` the largest share of the window in
    contact that it was trained with, `heldout` the indenters that it was not; `errors` are what
    `evaluate_gel` found.

    Raises ValueError: the weights are not those of such a network, or not finite.
    """

    def __init__(
        self,
        weights: Mapping[str, np.ndarray],
        fingerprint: str,
        deepest_mm: float,
        largest_share: float,
        heldout: Sequence[str] = (),
        errors: dict | None = None,
    ):
        self.weights = {k: np.ascontiguousarray(v, np.float32) for k, v in weights.items()}
        _check(self.weights)
        self.fingerprint, self.heldout, self.errors = fingerprint, tuple(heldout), errors or {}
        self.deepest_mm, self.largest_share = deepest_mm, largest_share

    def displacement(self, depth_mm: np.ndarray) -> np.ndarray:
        """Displacement of the gel's face in mm under probe grids, ([B,] 80, 59), float32.

        It is zero where a grid is. Beyond `deepest_mm` the gel adds what it adds there. A grid among others
        is rounded otherwise than alone (1e-6 mm). Raises ValueError where the shape is another or a depth not
        finite.
        """
        depth = np.asarray(depth_mm, np.float32)
        if depth.ndim not in (2, 3) or depth.shape[-2:] != (ROWS, COLS):
            raise ValueError(f"probe grids have shape ([B,] {ROWS}, {COLS}); got {depth.shape}")
        grids = depth.reshape(-1, ROWS, COLS)
        out = np.empty_like(grids)
        if not kern.displacements(*self._network, grids, self._rest, np.float32(self.deepest_mm), out):
            raise ValueError("a probe grid holds a depth that is no finite number")
        return out.reshape(depth.shape)

    @cached_property
    def _network(self) -> tuple:
        """Kernels, biases and work space, as the compiled code takes them."""
        kernels = [self.weights[f"{layer}.weight"] for layer in LAYERS]
        biases = tuple(self.weights[f"{layer}.bias"] for layer in LAYERS)
        flat = tuple(np.ascontiguousarray(k.reshape(*k.shape[:2], -1)) for k in kernels)
        return flat, biases, kern.workspace(_channels(self.weights))

    @cached_property
    def _rest(self) -> np.ndarray:
        rest = np.zeros((1, ROWS, COLS), np.float32)
        kern.added(*self._network, rest)
        return rest[0]

    def out_of_range(self, depth_mm: np.ndarray) -> np.ndarray:
        """Whether probe grids (..., 80, 59) lie deeper, or cover more of the window, than in training."""
        depth = np.asarray(depth_mm)
        share = np.count_nonzero(depth, (-2, -1)) / (ROWS * COLS)
        return (depth.max((-2, -1)) > self.deepest_mm) | (share > self.largest_share)

    def save(self, path: str | Path) -> None:
        """Writes weights and what is known about them as safetensors."""
        metadata = {
            "format": FORMAT,
            "fingerprint": self.fingerprint,
            "deepest_mm": repr(float(self.deepest_mm)),
            "largest_share": repr(float(self.largest_share)),
            "heldout": json.dumps(self.heldout),
            "errors": json.dumps(self.errors),
        }
        with whole(Path(path)) as part:
            save_file(self.weights, part, metadata)

    @classmethod
    def load(cls, path: str | Path) -> "GelSurrogate":
        """Reads what `save` wrote.

        Raises InputError where there is no such file, or it is damaged or of another kind.
        """
        if not Path(path).is_file():
            raise InputError(f"There is no perception network '{path}'; train one with `pneutac surrogate`.")
        refuse_pointer(Path(path))
        try:
            with safe_open(path, "np") as f:
                about, weights = f.metadata() or {}, {k: f.get_tensor(k) for k in f.keys()}  # noqa: SIM118
            limits = (float(about["deepest_mm"]), float(about["largest_share"]))
            if about["format"] != FORMAT or not all(0 < v < np.inf for v in limits):
                raise ValueError
            more = (json.loads(about[k]) for k in ("heldout", "errors"))
            return cls(weights, about["fingerprint"], *limits, *more)
        except (SafetensorError, OSError, KeyError, ValueError) as e:
            raise InputError(
                f"'{path}' is no perception network, or is damaged; train one with `pneutac surrogate`."
            ) from e


def _channels(weights: Mapping[str, np.ndarray]) -> tuple[int, int, int]:
    return tuple(len(weights[f"down{level}.0.bias"]) for level in (1, 2, 3))


def _check(weights: Mapping[str, np.ndarray]) -> None:
    a, b, c = _channels(weights)
    block = kern.BLOCK**2
    outputs = (a, a, b, b, c, c, b, b, a, a, block)
    inputs = (block, a, a, b, b, c, c + b, b, b + a, a, a)
    wanted = {f"{layer}.bias": (o,) for layer, o in zip(LAYERS, outputs, strict=True)}
    for layer, o, i in zip(LAYERS, outputs, inputs, strict=True):
        wanted[f"{layer}.weight"] = (o, i, 1, 1) if layer == "out" else (o, i, 3, 3)
    if {k: w.shape for k, w in weights.items()} != wanted or any(n % 2 for n in (a, b, c)):
        raise ValueError("these are not the weights of the perception network")
    if not all(np.isfinite(w).all() for w in weights.values()):
        raise ValueError("the perception network has weights that are no finite numbers")
