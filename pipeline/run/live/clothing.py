"""Clothes of the people of a live capture so far: their colours as evidence of who comes back.

The colours, their distances and what these tell are those of finished sessions (``identity.clothes``). A person's
colours are two means, of the earlier and of the later part of the time in sight: how far they are apart tells how much
one person's colours vary. Once the later part is as long as the earlier one, both become the earlier one, so that
memory does not grow with the time.
"""

from collections.abc import Iterable, Mapping, Sequence, Set
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from pipeline.association.identity.clothes import (
    Clothes,
    Contrast,
    learn_contrast,
    log_likelihood_ratios_of,
    mean_clothes,
)

# People from whose distances it is learnt what clothes tell: the time grows with the square of their number.
_MOST_LEARNT = 16

ColourOfCamera = tuple[int, UInt8[np.ndarray, "parts bins"]]
"""Position of a camera, and the colours of a detection in its picture, as of ``detect.appearance``."""


class _Halves(NamedTuple):
    """Colours of the earlier and of the later part of a person's sight."""

    earlier: Clothes
    later: Clothes

    @property
    def whole(self) -> Clothes:
        return self.earlier.joined(self.later)

    def extended(self, clothes: Clothes) -> "_Halves":
        """Colours after some more time in sight."""
        if self.later.num_detections.sum() < self.earlier.num_detections.sum():
            return _Halves(self.earlier, self.later.joined(clothes))
        return _Halves(self.whole, clothes)


class LiveClothes:
    """Clothes of people by their numbers."""

    def __init__(self, num_cameras: int) -> None:
        self._num_cameras = num_cameras
        self._halves: dict[int, _Halves] = {}  # The latest people come last
        # People who were in sight together with each person, and so are others.
        self._others: dict[int, set[int]] = {}

    def __len__(self) -> int:
        return len(self._halves)

    def add(self, number: int, colours: Sequence[ColourOfCamera]) -> None:
        """Take the colours of a person's detections of some time, one at least."""
        cameras, histograms = zip(*colours, strict=True)
        clothes = mean_clothes(np.array(histograms), np.array(cameras), self._num_cameras)
        known = self._halves.pop(number, None)
        nothing = Clothes(0 * clothes.share, 0 * clothes.num_detections)
        self._halves[number] = _Halves(clothes, nothing) if known is None else known.extended(clothes)

    def meet(self, number: int, others: Iterable[int]) -> None:
        """Note that other people are in sight together with a person."""
        for other in others:
            self._others.setdefault(number, set()).add(other)
            self._others.setdefault(other, set()).add(number)

    def merge(self, number: int, former: int) -> None:
        """Give all of a person to another number, which is that of the same person."""
        if (halves := self._halves.pop(number, None)) is not None:
            known = self._halves.get(former)
            self._halves[former] = halves if known is None else known.extended(halves.whole)
        others = self._others.pop(number, set())
        for other in others:
            self._others[other].discard(number)
        self.meet(former, others)

    def keep(self, numbers: Set[int]) -> None:
        """Forget all other people."""
        for number in (self._halves.keys() | self._others.keys()) - numbers:
            self._halves.pop(number, None)
            for other in self._others.pop(number, set()):
                self._others[other].discard(number)

    def log_ratios(self, number: int, others: Sequence[int]) -> Mapping[int, float]:
        """Log-likelihood ratios that a person is each of others, against being somebody else; 0 where nothing tells."""
        known = [other for other in others if other in self._halves]
        ratios = dict.fromkeys(others, 0.0)
        if number in self._halves and known:
            wholes = [self._halves[other].whole for other in known]
            of_known = log_likelihood_ratios_of(self._halves[number].whole, wholes, self._contrast())
            ratios |= zip(known, of_known.tolist(), strict=True)
        return ratios

    def _contrast(self) -> Contrast:
        """How much the clothes of the latest people tell."""
        numbers = list(self._halves)[-_MOST_LEARNT:]
        halves = [self._halves[number] for number in numbers]
        are_different = [[other in self._others.get(number, ()) for other in numbers] for number in numbers]
        return learn_contrast([each.whole for each in halves], halves, np.array(are_different))
