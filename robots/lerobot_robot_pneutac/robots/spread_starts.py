"""Which of many random starts a few demonstrations should have, so that every one is near to one of them."""

import numpy as np


class SpreadStarts:
    """Chooses so that the mean distance to the nearest start done is least, one after the other.

    The greedy way through the k-median problem: Cornuejols, Fisher and Nemhauser, Management Science 23
    (1977) 789.

    Args:
        places: seed of a start to where its things are (N, 3), m.
    """

    def __init__(self, places: dict[int, np.ndarray]):
        self._seeds = list(places)
        points = np.array(list(places.values()))
        self._apart_m = np.linalg.norm(points[:, None] - points[None], axis=-1).mean(-1)  # (starts, starts)
        self._nearest_m = np.full(len(points), np.inf)
        self._given: list[int] = []

    def next(self) -> int:
        """The seed that helps most, and was not given before while there are others."""
        if len(self._given) == len(self._seeds):
            self._given.clear()
        left = [k for k in range(len(self._seeds)) if k not in self._given]
        mean_m = np.minimum(self._nearest_m, self._apart_m[left]).mean(-1)
        self._given.append(left[int(np.argmin(mean_m))])
        return self._seeds[self._given[-1]]

    def done(self, seed: int) -> None:
        """Tells that there is a demonstration of a start now."""
        self._nearest_m = np.minimum(self._nearest_m, self._apart_m[self._seeds.index(seed)])
