"""Ranges from several hydrophones to one target: fixes, starts and lasting errors come with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import array, freeze_columns, frozen_array, per_axis
from trackrs.errors import DimensionError, ParameterError
from trackrs.sensor import Sensor
from trackrs.types import Fix

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

Side = Literal["above", "below"]


@dataclass(frozen=True, slots=True, eq=False)
class RangeArray(Sensor):
    """Ranges from k hydrophones (or radio anchors) to one target, or their travel times, and the target's depth.

    Measurement: k ranges in metres, or k travel times in seconds if `sound_speed` is given; then the depth in metres if
    `depth_std` is given. NaN = not heard. In 3 dimensions the last coordinate is depth, positive down.

    With such a sensor a filter starts by itself: `run(times, values)` needs no `initial`.

    Ranges may have lasting errors, which an `ExtendedKalmanFilter` then estimates with the target: range = (1 + scale)
    x distance + bias. They stand behind the state of the motion: `run.labels` has `bias0 ... bias{k-1}` and `scale`,
    and `run.means[:, run.labels.index("scale")]` is the estimate. `initial` and `inputs` may leave them out: they are
    then as known beforehand, zero with `bias_std` and `scale_std`, and have no input. The depth has no such error.

    Args:
        hydrophones: positions (k, d), metres, d = 2 or 3.
        range_std: standard deviation of a range, metres; a number or one per hydrophone. Travel times have
            `range_std` over the effective speed, over that at the hydrophone where a profile is given.
        depth_std: standard deviation of the depth, metres; None = the target does not report its depth.
        sound_speed: m/s. None: measurements are ranges. A number or one per hydrophone (k,): effective speeds. Rows
            (n, 2) of depth and speed, depths increasing: a profile, linear between its rows, whose harmonic mean along
            the straight ray is the effective speed; it changes with the depth of the target, also in the Jacobian.
        side: "above" or "below": which of two mirror images the target is, where a fix leaves both (see `fix`).
        survey_std: standard deviation of a hydrophone's position along the ray, metres; a number or one per hydrophone,
            for example `geodesy.place_array(...).survey_std`. Ranges get the variance range_std² + survey_std². That
            treats the survey as white noise: ranges to a badly surveyed hydrophone weigh less and are not taken for
            gross errors, but its error does not average out as the filter then believes, so that covariances are too
            small after many measurements. None: the survey is exact.
        bias_std: standard deviation of the range biases before any measurement, metres; a number or one per hydrophone.
            None: there are none.
        scale_std: the same of one relative error common to all ranges, such as that of the sound speed. None: there is
            none.
        bias_psd: how fast the biases wander, m²/s: after dt seconds they have changed with variance `bias_psd` dt.
        scale_psd: the same of the relative error, 1/s.

    Raises:
        DimensionError: `hydrophones` is not (k, 2) or (k, 3), or another shape does not fit.
        ParameterError: a standard deviation or speed is not positive (`survey_std` may be zero), or depth is used in 2
            dimensions; a density is negative or has no standard deviation to go with.

    Reference:
        Xi, Liu, Tao, Lu, "Tracking submarine moving target with the adaptive estimation methodology"; spec label U5.

    Example:
        >>> import trackrs as tr
        >>> array = tr.RangeArray([[0, 0, 250], [1000, 0, 252], [500, 866, 248]], range_std=1.5, depth_std=0.5)
        >>> array.observe([0.0, 0.0, 50.0])
        array([ 200.        , 1020.19801999, 1019.39197564,   50.        ])
        >>> array.fix([200.0, 1020.2, 1019.4, 50.0]).dof
        1
        >>> radios = tr.RangeArray([[0, 0], [90, 0], [50, 60]], range_std=0.5, scale_std=0.1)
        >>> tr.ExtendedKalmanFilter(tr.ConstantVelocity(dims=2, accel_psd=0.1), radios).labels
        ('x', 'y', 'vx', 'vy', 'scale')
    """

    hydrophones: ArrayLike
    range_std: float | Sequence[float]
    depth_std: float | None = None
    sound_speed: float | ArrayLike | None = None
    side: Literal["above", "below"] | None = None
    survey_std: float | ArrayLike | None = None
    bias_std: float | Sequence[float] | None = None
    scale_std: float | None = None
    bias_psd: float = 0.0
    scale_psd: float = 0.0

    def __init__(
        self,
        hydrophones: ArrayLike,
        range_std: float | Sequence[float],
        depth_std: float | None = None,
        sound_speed: float | ArrayLike | None = None,
        side: Side | None = None,
        survey_std: float | ArrayLike | None = None,
        *,
        bias_std: float | Sequence[float] | None = None,
        scale_std: float | None = None,
        bias_psd: float = 0.0,
        scale_psd: float = 0.0,
    ) -> None:
        """Copy the arrays and build the model."""
        bias = None if bias_std is None else per_axis(bias_std, len(array(hydrophones, "hydrophones", 2)), "bias_std")
        for name, std, psd in (("bias", bias, bias_psd), ("scale", scale_std, scale_psd)):
            if std is None and psd != 0.0:
                msg = f"{name}_psd = {psd} is invalid: needs {name}_std, the standard deviation that it adds to"
                raise ParameterError(msg)
        extra: dict[str, Any] = {
            "bias": None if bias is None else (bias, float(bias_psd)),
            "scale": None if scale_std is None else (float(scale_std), float(scale_psd)),
        }
        self._build(hydrophones, range_std, depth_std, sound_speed, side, survey_std, None, extra)
        kept = bias_std if bias is None or isinstance(bias_std, float | int) else tuple(bias)
        values = {"bias_std": kept, "scale_std": scale_std, "bias_psd": bias_psd, "scale_psd": scale_psd}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _build(
        self,
        hydrophones: ArrayLike,
        range_std: float | Sequence[float],
        depth_std: float | None,
        sound_speed: float | ArrayLike | None,
        side: Side | None,
        survey_std: float | ArrayLike | None,
        preset: str | None,
        extra: dict[str, Any] | None = None,
    ) -> None:
        positions = frozen_array(hydrophones, "hydrophones", 2)
        std = per_axis(range_std, len(positions), "range_std")
        core = _trackrs.Sensor.range_array(
            positions,
            std,
            depth_std=None if depth_std is None else float(depth_std),
            side=side,
            preset=preset,
            survey_std=None if survey_std is None else _numbers(survey_std, "survey_std"),
            **_speeds(sound_speed),
            **(extra or {}),
        )
        if survey_std is not None and np.ndim(survey_std) > 0:
            survey_std = frozen_array(survey_std, "survey_std", 1)
        if sound_speed is not None and np.ndim(sound_speed) > 0:
            sound_speed = frozen_array(sound_speed, "sound_speed", np.ndim(sound_speed))
        values = {
            "hydrophones": positions,
            "range_std": range_std,
            "depth_std": depth_std,
            "sound_speed": sound_speed,
            "side": side,
            "survey_std": survey_std,
            "bias_std": None,
            "scale_std": None,
            "bias_psd": 0.0,
            "scale_psd": 0.0,
            "_core": core,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @classmethod
    def bats(
        cls,
        hydrophones: ArrayLike,
        range_std: float = 1.0,
        depth_std: float = 0.3,
        sound_speed: float | ArrayLike | None = None,
        survey_std: float | ArrayLike | None = None,
    ) -> RangeArray:
        """Return the BATS array: three hydrophones (3, 3), not collinear in plan, and the target's depth.

        Raises:
            DimensionError: there are not three hydrophones in 3 dimensions.
            ParameterError: they are collinear in plan.
        """
        made = cls.__new__(cls)
        made._build(hydrophones, range_std, depth_std, sound_speed, None, survey_std, "bats")
        return made

    @classmethod
    def toss(
        cls,
        hydrophones: ArrayLike,
        range_std: float = 1.0,
        sound_speed: float | ArrayLike | None = None,
        side: Side = "above",
        survey_std: float | ArrayLike | None = None,
    ) -> RangeArray:
        """Return the TOSS array: six hydrophones (6, 3) on the sea floor, not collinear, and no depth.

        They lie almost in one plane, so that a fix may leave a mirror image; the target is above it unless `side` says
        otherwise.

        Raises:
            DimensionError: there are not six hydrophones in 3 dimensions.
            ParameterError: they are collinear.
        """
        made = cls.__new__(cls)
        made._build(hydrophones, range_std, None, sound_speed, side, survey_std, "toss")
        return made

    @classmethod
    def stack(cls, arrays: Sequence[RangeArray]) -> RangeArray:
        """Return several arrays as one: all their ranges in this order, and the depth, if any, last.

        Fixes, starts, filters and screens work on it as on any array, and it is the best way to fuse arrays. There is
        one depth, with the smallest `depth_std` of the arrays: the target measures it, and what several arrays receive
        is one report, whose error must not count as several independent ones.

        To fuse array by array as their measurements come in, give the stacked array rows at one time (or at their own
        times) with NaN in the channels of the others, and `initial`. For linear sensors that is the stacked update, up
        to rounding; an extended filter linearises anew after every row, so that it differs by its nonlinearity.

        Args:
            arrays: at least one. All have the same number of coordinates, and all measure ranges or all travel times;
                those with a sound speed profile must share it. None has `bias_std` or `scale_std`: declare these in one
                array of all hydrophones. Sides must agree; one that an array without depth gave
                is about the depth, and is dropped where the stack measures the depth.

        Raises:
            ParameterError: no array, or arrays that do not go together; the message says in what.
            DimensionError: different numbers of coordinates.

        Reference:
            Spec label U29.

        Example:
            >>> import trackrs as tr
            >>> near = tr.RangeArray([[0, 0, 250], [1000, 0, 252], [500, 866, 248]], range_std=1.5, depth_std=0.5)
            >>> far = tr.RangeArray([[2000, 0, 300], [3000, 0, 310]], range_std=3.0)
            >>> tr.RangeArray.stack([near, far]).labels
            ('range0', 'range1', 'range2', 'range3', 'range4', 'depth')
        """
        out = _trackrs.Sensor.stack([array._core for array in arrays])
        speeds = out["speeds"]
        # No speeds: ranges, or a profile, which all of them share.
        speed = arrays[0].sound_speed if speeds is None else speeds[0] if len(speeds) == 1 else speeds
        return cls(
            out["hydrophones"],
            out["range_std"],
            depth_std=out["depth_std"],
            sound_speed=speed,
            side=out["side"],
            survey_std=out["survey_std"] or None,
        )

    def fix(self, values: ArrayLike, side: Side | None = None) -> Fix:
        """Return the position that one measurement (m,) gives by itself; any d ranges, or d - 1 and the depth, will do.

        Lasting errors (`bias_std`, `scale_std`) are taken as zero and count in the covariance and in the test.
        Gauss-Newton from the closed-form positions. The test of its redundancy (`p_value`) shows a gross error; with
        `dof = 0` nothing can.

        Args:
            values: one measurement; NaN = not heard.
            side: which of two mirror images to take where both fit (chi-square less than 20 apart): "above" is the
                smaller depth, or the smaller y in 2 dimensions and where the depth is measured. None: `self.side`.

        Raises:
            UnobservableError: too few channels heard, their hydrophones collinear, no convergence, or an ambiguity
                that `side` does not resolve; the message names them.
            ParameterError: a range is negative or contradicts the others beyond any error; the message names it.
            NonFiniteError: a value is infinite.
            DimensionError: there are not m values.

        Reference:
            Xi, Liu, Tao, Lu; spec labels U10 (known depth), U10b (two spheres), U11 (Gauss-Newton).
        """
        return Fix(**freeze_columns(self._core.fix(array(values, "values", 1), side)))


def _numbers(value: ArrayLike, name: str) -> list[float]:
    """Return a number or a row of numbers as a list."""
    numbers: list[float] = array(np.atleast_1d(value), name, 1).tolist()
    return numbers


def _speeds(sound_speed: float | ArrayLike | None) -> dict[str, Any]:
    """Return the arguments of the compiled module that say what `sound_speed` says."""
    if sound_speed is None:
        return {}
    if np.ndim(sound_speed) < 2:
        return {"speeds": _numbers(sound_speed, "sound_speed")}
    profile = array(sound_speed, "sound_speed", 2)
    if profile.shape[1] != 2:
        msg = f"sound_speed as a profile needs rows of depth and speed (n, 2), got shape {profile.shape}"
        raise DimensionError(msg)
    return {"profile": (profile[:, 0].tolist(), profile[:, 1].tolist())}
