"""An angle measured at equal intervals."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, frozen
from trackrs.scenarios._recipe import Recalled, remembered
from trackrs.scenarios._stream import stream_number
from trackrs.types import GaussianState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True, eq=False)
class Angles:
    """What one run of `Turning` measured.

    Attributes:
        initial: where a filter begins: the first measurement, at time 0, with rate and acceleration unknown.
        times: (T,) seconds, of the measurements after it.
        values: (T, 1) these measurements.
    """

    initial: GaussianState
    times: FloatArray
    values: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Turning(Recalled):
    """An angle that is measured at equal intervals; see `turntable` and `moving_head`, which make it.

    Attributes:
        std: standard deviation of a measurement, in the unit of the angle.
        times: (T,) seconds, of the measurements after the first.
    """

    std: float
    times: FloatArray = field(repr=False)
    _core: _trackrs.Turning = field(repr=False)

    def truth(self, times: ArrayLike) -> FloatArray:
        """Return the angle (T,) at these times."""
        return frozen(self._core.truth(array(times, "times", 1)))

    def draw(self, seed: int, run: int = 0) -> Angles:
        """Return run number `run` of a study with this seed, both from 0 to 2⁶⁴ - 1.

        Raises:
            ParameterError: `seed` or `run` is no such number.
        """
        out: dict[str, Any] = self._core.draw(stream_number("seed", seed), stream_number("run", run))
        initial = GaussianState(out["mean"], out["cov"], 0.0)
        return Angles(initial, self.times, frozen(out["values"].reshape(-1, 1)))


@remembered
def turntable(rate: float = 10.0, *, period: float = 0.05, samples: int = 181, std: float = 0.0724) -> Turning:
    """Return the turntable of the helmet paper: 10 degrees a second, 20 frames a second, 9 s.

    Args:
        rate: of turning, degrees a second.
        period: seconds between measurements, the first one at 0.
        samples: how many, at least 2.
        std: standard deviation of each, degrees.

    Raises:
        ParameterError: a parameter is outside its domain.

    Reference:
        Sun, Zhang (2015), section 4; what a filter begins with is that of section 4 of its spec.

    Example:
        >>> import trackrs as tr
        >>> scene = tr.scenarios.turntable()
        >>> scene.truth([0.9]), scene.draw(seed=7).values.shape
        (array([9.]), (180, 1))
    """
    return _turning(rate, [], period, samples, std)


@remembered
def moving_head(
    swings: Sequence[tuple[float, float]] = ((30.0, 0.5), (5.0, 1.3)),
    *,
    period: float = 0.05,
    samples: int = 1200,
    std: float = 0.0724,
) -> Turning:
    """Return a head that shakes and nods for a minute: what a turntable does not show.

    Args:
        swings: amplitude, degrees, and frequency, Hz, of each motion.
        period: seconds between measurements, the first one at 0.
        samples: how many, at least 2.
        std: standard deviation of each, degrees.

    Raises:
        ParameterError: a parameter is outside its domain.

    Reference:
        Section 4 of the spec of the helmet paper.
    """
    return _turning(0.0, [tuple(swing) for swing in swings], period, samples, std)


def _turning(rate: float, swings: list[tuple[float, ...]], period: float, samples: int, std: float) -> Turning:
    core = _trackrs.Turning.make(rate, swings, period, samples, std)
    return Turning(float(std), frozen(core.times()), core)
