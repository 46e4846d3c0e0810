"""How a filter begins: the state that a few position fixes give."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from trackrs import _trackrs
from trackrs._arrays import array
from trackrs.errors import DimensionError, ParameterError
from trackrs.types import GaussianState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from trackrs.motion import Motion
    from trackrs.types import Fix


def start_state(
    times: ArrayLike,
    fixes: Sequence[Fix],
    *,
    order: int = 3,
    motion: Motion | None = None,
    rule: Literal["polynomial", "paper"] = "polynomial",
    velocity_std: float | None = None,
    accel_std: float | None = None,
) -> GaussianState:
    """Return the state at the last of a few position fixes: how a filter begins without being told where.

    `run(times, values)` of a `RangeArray` does this by itself, with tested fixes; here it is for fixes of your own
    choice.

    "polynomial" lays position, velocity and acceleration through the fixes, with the full covariance that follows from
    theirs: strongly correlated.

    "paper" is the rule of the paper as printed, for comparison: position of the last fix, velocity of the first
    interval, acceleration as the change of velocity over the last interval, and a block-diagonal covariance with the
    given standard deviations. What is wrong with it: that velocity held one and a half steps before the time of the
    position; the acceleration is right for equal steps only, else the divisor is half the time between the first and
    the last fix; and the blocks are not independent. On the reference courses it makes the first five innovations 1.5
    to 1.6 times as large (chi-square per component) as their covariances say, enough for a gate to lock the filter out.

    Args:
        times: (order,) seconds, increasing.
        fixes: as many, each with `position` (d,) and `cov` (d, d), for example from `RangeArray.fix`.
        order: 1 position, 2 and velocity, 3 and acceleration; as many fixes are needed. "paper" has 3.
        motion: its noise between the fixes joins the covariance; its states must have `order` blocks. "polynomial"
            only.
        rule: "polynomial" or "paper".
        velocity_std: m/s, of every velocity component, with "paper".
        accel_std: m/s², of every acceleration, with "paper".

    Raises:
        ParameterError: an argument belongs to the other rule or is missing, times are equal, or `order` is not 1, 2 or
            3.
        DimensionError: the numbers of times and fixes do not fit.
        TimeError: times decrease.

    Reference:
        Xi, Liu, Tao, Lu, initial values; spec label U12.

    Example:
        >>> import trackrs as tr
        >>> array = tr.RangeArray([[0, 0, 250], [1000, 0, 252], [500, 866, 248]], range_std=1.0, depth_std=0.3)
        >>> fixes = [array.fix(array.observe([10.0 * t, 5.0, 60.0])) for t in (0.0, 1.0, 2.0)]
        >>> tr.start_state([0.0, 1.0, 2.0], fixes).mean.round(3) + 0.0
        array([20.,  5., 60., 10.,  0.,  0.,  0.,  0.,  0.])
    """
    rules = {"polynomial", "paper"}
    if rule not in rules:
        msg = f'rule = {rule} is invalid: must be "polynomial" or "paper"'
        raise ParameterError(msg)
    t = array(times, "times", 1)
    if len(t) != len(fixes):
        msg = f"times has size {len(t)}, expected {len(fixes)}, one per fix"
        raise DimensionError(msg)
    given = [(array(fix.position, "position", 1), array(fix.cov, "cov", 2)) for fix in fixes]
    if rule == "paper":
        if order != 3 or motion is not None or velocity_std is None or accel_std is None:
            msg = 'rule = "paper" is invalid: needs velocity_std= and accel_std=, order 3 and no motion'
            raise ParameterError(msg)
        mean, cov = _trackrs.paper_start(t, given, velocity_std, accel_std)
    else:
        if velocity_std is not None or accel_std is not None:
            msg = 'rule = "polynomial" is invalid: velocity_std= and accel_std= belong to rule="paper"'
            raise ParameterError(msg)
        mean, cov = _trackrs.start_state(t, given, order, None if motion is None else motion._core)
    return GaussianState(mean, cov, t[-1])
