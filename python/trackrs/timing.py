"""Times that jitter about a fixed rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from trackrs import _trackrs
from trackrs._arrays import FloatArray, IntArray, array, freeze_columns

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True, eq=False)
class RegularTimes:
    """Times on a regular clock.

    Attributes:
        times: (T,) seconds, whole numbers of periods apart.
        period: seconds.
        steps: (T,) steps since the first; a gap is a whole number of them.
        jitter: root mean square of the recorded times about these, seconds. Half a period of it, and steps are guesses.
    """

    times: FloatArray
    period: float
    steps: IntArray
    jitter: float

    def __len__(self) -> int:
        """Return the number of times."""
        return len(self.times)


def regularise(times: ArrayLike, period: float | None = None) -> RegularTimes:
    """Return the times of a clock of fixed rate from stamps that jitter about them.

    For sensors that sample regularly and are stamped late or unevenly, as headsets often are. Where the stamps are
    real, and it is the sampling that is uneven, they are better used as they are.

    Args:
        times: (T,) recorded stamps, seconds, not decreasing. Stamps on different steps may coincide.
        period: of the clock, seconds. None: estimated, with the median of the differences to begin with.

    Returns:
        The regular times, with period and jitter.

    Raises:
        TimeError: times decrease.
        NonFiniteError: a time is not finite.
        ParameterError: fewer than two times, a period that is not positive, or none given and most times equal.

    Example:
        >>> import trackrs as tr
        >>> regular = tr.regularise([0.0, 1.01, 2.3, 2.98, 6.02, 7.0], period=1.0)
        >>> regular.steps.tolist(), round(regular.jitter, 3)
        ([0, 1, 2, 3, 6, 7], 0.112)
    """
    given = None if period is None else float(period)
    return RegularTimes(**freeze_columns(_trackrs.regularise(array(times, "times", 1), given)))
