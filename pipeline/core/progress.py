"""Progress of a reconstruction: steps of a stage, and callbacks for shares of a piece of work."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a stage of ``pipeline.run.engine.plan.STAGES``.

    Parameters
    ----------
    stage
        Name of the stage.
    done, total
        Units of the stage that are done, and all of them.
    reused
        Units among ``done`` whose outputs an earlier run has left.

    Examples
    --------
    >>> progress = Progress("detect", 12, 24, reused=6)
    >>> f"{progress.done / progress.total:.0%}"
    '50%'
    """

    stage: str
    done: int
    total: int
    reused: int = 0


OnProgress = Callable[[Progress], None]


def silent(_: Progress) -> None:
    """Report nothing."""


OnShare = Callable[[float], None]
"""Callback that takes the completed share of a piece of work, from 0 to 1, ascending."""


def ignore(_: float) -> None:
    """Report nothing."""


def sub_share(on_share: OnShare, start: float, stop: float) -> OnShare:
    """Make the callback of a part of the work. It goes from the share ``start`` of the whole work to ``stop``."""
    return lambda share: on_share(start * (1.0 - share) + stop * share)


def split(on_share: OnShare, weights: Sequence[int]) -> list[OnShare]:
    """Split work into consecutive parts, and return the callback of each part.

    ``weights`` are the amounts of work in the parts.
    """
    total = sum(weights) or 1
    borders = [border / total for border in accumulate(weights, initial=0)]
    return [sub_share(on_share, *ends) for ends in pairwise(borders)]


def in_units(total: int, on_unit: Callable[[], None]) -> OnShare:
    """Make a callback that calls ``on_unit`` once for each of ``total`` units of work that is completed."""
    done = 0

    def on_share(share: float) -> None:
        nonlocal done
        while done < int(share * total):
            done += 1
            on_unit()

    return on_share
