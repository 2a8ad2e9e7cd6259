"""Which frame of a demonstration comes next in a new scene, and where it lies there.

Before a touch nobody knows where the object is, so the demonstrated way is gone as it was, and farther or
less far until the touch comes. In contact it lies where the touch came.
"""

import numpy as np

from pneutac_datasets.augment_reference import Reference

EARLY, LATE = 16, 16  # control steps by which a touch may come before and after the demonstrated one
BUMP = 6  # frames; shorter contacts need not come


class Course:
    """The course of a demonstration through a new scene; `advance` is called once a control step.

    Args:
        reference: the demonstration.
        aside_m: (3,) displacement of its free ways.

    Attributes:
        frame: of the reference.
        offset_m: (3,) displacement of the reference's path now.
        in_contact: whether this frame belongs to a contact that has come.
    """

    def __init__(self, reference: Reference, aside_m: np.ndarray):
        self._contacts = list(reference.contacts)
        self._reference, self._aside_m = reference, np.asarray(aside_m, float)
        self._waited = 0
        self.frame, self.offset_m, self.in_contact = -1, self._aside_m, False

    def advance(self, touched: bool, flange_m: np.ndarray) -> bool:
        """Goes on to the next frame.

        Args:
            touched: whether the gel feels anything.
            flange_m: (3,) where the flange is.

        Returns:
            False where a touch that the demonstration had does not come.
        """
        self.frame += 1
        if self._contacts and self.frame >= self._contacts[0][1]:  # over
            del self._contacts[0]
            self.in_contact = False
        if self.in_contact or not self._contacts:
            self.offset_m = self.offset_m if self.in_contact else self._aside_m
            return True
        first, end = self._contacts[0]
        if touched and first - self.frame <= EARLY:
            self.frame, self.in_contact, self._waited = first, True, 0
            self.offset_m = flange_m - self._reference.flange_m[first]
        elif self.frame == first:
            if end - first < BUMP:
                del self._contacts[0]
                return True
            self._waited += 1
            self.frame = first - 1
            return self._waited <= LATE
        else:
            self.offset_m = self._aside_m
        return True

    @property
    def waiting(self) -> bool:
        """Whether a touch is overdue."""
        return self._waited > 0
