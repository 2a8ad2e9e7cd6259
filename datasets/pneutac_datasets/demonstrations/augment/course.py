"""Which frame of a demonstration comes next in a new scene, and where it lies there.

Before a touch nobody knows where the object is, so the demonstrated way is gone as it was, until the touch
comes: earlier, later, or more to one side of the gel. In contact the demonstrated way goes on from there, led
aside by as much as the demonstrations answer a touch elsewhere on the gel; along directions in which they do
not, it lies where the object is. It lasts until the touch is gone: whoever let go by the clock would teach
that to let go is not a matter of touch.
"""

import numpy as np

from pneutac_datasets.demonstrations.augment.reference import FIRM, Reference

# Frames of the paper's rate, see `reference.frames_at`.
EARLY = 16  # by which a touch may go before the demonstrated one
LATE_TOUCH, LATE_RELEASE = 8, 30  # and after it: who goes on for long has missed the object
GONE = 2  # frames without touch after which it is over
BUMP = 6  # frames; shorter contacts need not come


class Course:
    """The course of a demonstration through a new scene; `advance` is called once a control step.

    Args:
        reference: the demonstration.
        aside_m: how far to the side, along y, the object stands from where it stood.
        reaction_hz: (3, 2), see `reference.reaction_hz`.

    Attributes:
        frame: of the reference.
        offset_m: (3,) displacement of the reference's path now.
        in_contact: whether this frame belongs to a contact that has come.
        answer: (3 + C,) to be added to the action, as the touch is elsewhere on the gel than it was.
    """

    def __init__(self, reference: Reference, aside_m: float, reaction_hz: np.ndarray):
        self._contacts, self._reaction_hz = list(reference.contacts), reaction_hz
        self._centre_mm = _since_touched(reference)
        self._reference, self._aside_m, self._frames = reference, aside_m, reference.frames
        self._waited = self._lost = 0
        self._largest = 0.0
        self.frame, self.offset_m, self.in_contact = -1, np.zeros(3), False
        self.answer = np.zeros(reference.action.shape[1])

    def advance(self, area: float, centre_mm: np.ndarray, flange_m: np.ndarray) -> bool:
        """Goes on to the next frame; False where a demonstrated touch does not come, or does not end.

        Args:
            area: contact area that the gel feels.
            centre_mm: (2,) middle of the imprint; NaN without touch.
            flange_m: (3,) where the flange is.
        """
        self.frame += 1
        if self.in_contact and not self._stay_in_contact(area):
            return False
        goes_on = self.in_contact or self._search(area > 0, flange_m)
        self._answer(centre_mm)
        return goes_on

    def _answer(self, centre_mm: np.ndarray) -> None:
        """Leads the way aside as the demonstrations do where the touch is elsewhere than it was."""
        self.answer = np.zeros_like(self.answer)
        elsewhere = 1e-3 * (centre_mm - self._centre_mm[min(self.frame, len(self._centre_mm) - 1)])
        if self.in_contact and np.isfinite(elsewhere).all():
            self.answer[:3] = self._reaction_hz @ elsewhere
        self.offset_m = self.offset_m + self.answer[:3] / self._reference.control_hz

    def _stay_in_contact(self, area: float) -> bool:
        """Ends a contact when the touch is gone, up to `EARLY` frames too soon; False if it is too late."""
        end, gone = self._contacts[0][1], self._frames(GONE)
        self._largest = max(self._largest, area)
        self._lost = 0 if area >= FIRM * self._largest or self._lasts else self._lost + 1
        if self._lost >= gone and end - self.frame <= self._frames(EARLY):
            self.frame = end
        elif self.frame == end and self._lost < gone:
            self._waited += 1
            if self._waited > self._frames(LATE_RELEASE):
                return False
            self.frame = end - 1
            self.offset_m = self.offset_m + self.onward_m
        if self.frame >= end:
            del self._contacts[0]
            self.in_contact, self._waited, self._lost = False, 0, 0
        return True

    def _search(self, touched: bool, flange_m: np.ndarray) -> bool:
        """The free way, until the next touch comes."""
        self.offset_m = np.zeros(3)
        if not self._contacts:
            return True
        if touched:
            while len(self._contacts) > 1 and self._is_bump(self._contacts[0]):
                del self._contacts[0]
        first, end = self._contacts[0]
        if touched:
            self.frame, self.in_contact, self._waited, self._largest = first, True, 0, 0.0
            self.offset_m = flange_m - self._reference.flange_m[first]
            if not self._reaction_hz[1].any():
                self.offset_m[1] = self._aside_m
        elif self.frame == first and self._is_bump(self._contacts[0]):
            del self._contacts[0]
        elif self.frame == first:
            self._waited += 1
            self.frame = first - 1
            return self._waited <= self._frames(LATE_TOUCH)
        return True

    def _is_bump(self, contact: tuple[int, int]) -> bool:
        return contact[1] - contact[0] < self._frames(BUMP)

    @property
    def _lasts(self) -> bool:
        """Whether the demonstration ended in this contact: then a touch that flickers is no release."""
        return self._contacts[0][1] == len(self._reference)

    @property
    def last(self) -> int:
        """The last frame that is certain: whether a contact is released is up to the touch."""
        return self._contacts[0][1] - 1 if self.in_contact else len(self._reference) - 1

    def area_goal(self, frames: np.ndarray) -> np.ndarray:
        """Contact areas (H,) that the demonstration asks for at `frames` (H,) of the present contact.

        NaN where it had let go: whoever asked for its last area there would cling to what gives way at last,
        and then press whatever lies behind it. A demonstration that ended in touch asks for its last area.
        """
        areas = self._reference.area[np.minimum(frames, self.last)]
        return areas if self._lasts else np.where(frames > self.last, np.nan, areas)

    @property
    def onward_m(self) -> np.ndarray:
        """(3,) mean motion of a control step in the contact, by which it goes on after the last frame."""
        path, first = self._reference.flange_m, self._contacts[0][0] if self.in_contact else 0
        return (path[self.last] - path[first]) / max(self.last - first, 1)

    @property
    def waiting(self) -> bool:
        """Whether a touch, or its end, is overdue."""
        return self._waited > 0


def _since_touched(reference: Reference) -> np.ndarray:
    """Middles of the imprints (T, 2), mm; the first that is seen also where a contact begins too softly."""
    if reference.centre_mm is None:
        return np.full((len(reference), 2), np.nan)
    centre = reference.centre_mm.copy()
    for first, end in reference.contacts:
        seen = np.flatnonzero(np.isfinite(centre[first:end, 0]))
        if len(seen):
            centre[first : first + seen[0]] = centre[first + seen[0]]
    return centre
