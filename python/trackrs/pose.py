"""Sensors of poses: position and attitude of a body, reported as such or seen by a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, freeze_columns, frozen, frozen_array, per_axis
from trackrs.errors import DimensionError
from trackrs.sensor import Sensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike


def _three(value: float | Sequence[float], name: str) -> tuple[float, float, float]:
    x, y, z = per_axis(value, 3, name)
    return (x, y, z)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSensor(Sensor):
    """A sensor that reports poses: position and attitude, or the attitude alone. NaN = not observed.

    With `attitude="euler"` the attitude is three angles, each a coordinate like any other; their residuals wrap. The
    state of a motion with 6 axes (3 without position) holds the same angles.

    With `attitude="quaternion"` reports hold a unit quaternion w, x, y, z (Hamilton, body to frame), of either sign.
    The state holds the attitude as a rotation vector, covariances are those of small turns in body axes: no gimbal
    lock, no seam. The extended, unscented and cubature filters take a motion with 6 axes (3 without position) and make
    it that of a rigid body, whose last three axes turn: the state is `x y z rx ry rz vx vy vz wx wy wz ...`, rates in
    body axes. `run` and `update` take the reports; `run.attitudes` are quaternions again. `measurements` turns reports
    into what innovations and `observe` are in: position and rotation vector.

    Args:
        position_std: standard deviation of the position, metres; a number or one per axis. None: no position is
            reported.
        angle_std: standard deviation of the angles, radians; a number or one per axis, in body axes with a quaternion.
        attitude: "euler" or "quaternion".

    Raises:
        ParameterError: a standard deviation is not positive.

    Reference:
        Sun, Zhang (2015), "Pose prediction method for moving helmet based on Kalman filtering", measurement equation;
        spec label H2. Rotation vectors: Solà, Deray, Atchuthan (2018), A micro Lie theory for state estimation in
        robotics.

    Example:
        >>> import trackrs as tr
        >>> head = tr.PoseSensor(angle_std=0.001, attitude="quaternion")
        >>> head.measurements([[0.0, 0.0, 0.0, 1.0], [-0.8, -0.6, 0.0, 0.0]]).round(4) + 0.0
        array([[0.    , 0.    , 3.1416],
               [1.287 , 0.    , 0.    ]])
        >>> ekf = tr.ExtendedKalmanFilter(tr.ConstantVelocity(dims=3, accel_psd=0.1), head)
        >>> ekf.labels
        ('rx', 'ry', 'rz', 'wx', 'wy', 'wz')
        >>> run = ekf.run([0.0, 0.1, 0.2, 0.3], [[1.0, 0, 0, 0], [-1.0, 0, 0, 0], [1.0, 0, 0, 0], [1.0, 0, 0, 0]])
        >>> run.attitudes[-1]
        array([1., 0., 0., 0.])
    """

    position_std: float | Sequence[float] | None = None
    angle_std: float | Sequence[float]
    attitude: Literal["euler", "quaternion"] = "quaternion"

    def __post_init__(self) -> None:
        """Build the model."""
        position = None if self.position_std is None else _three(self.position_std, "position_std")
        core = _trackrs.Sensor.pose(_three(self.angle_std, "angle_std"), self.attitude, position)
        object.__setattr__(self, "_core", core)

    def measurements(self, values: ArrayLike) -> FloatArray:
        """Return reports as measurements (T, m): a quaternion becomes its rotation vector, everything else stays.

        Args:
            values: (T, 6) position and angles or (T, 3) angles; with quaternions (T, 7) or (T, 4). A quaternion with a
                NaN was not observed. Its norm must be 1 within 0.01.

        Raises:
            ParameterError: a quaternion is zero or far from norm 1; the message names its row.
            NonFiniteError: a quaternion is infinite.
            DimensionError: the rows have another length.
        """
        return frozen(self._core.measurements(array(values, "values", 2)))


@dataclass(frozen=True, slots=True, eq=False)
class PoseFix:
    """A pose from one image.

    Attributes:
        position: of the body in the camera frame (3,), metres.
        quaternion: its attitude w, x, y, z (4,), body to camera frame, w not negative.
        cov: covariance (6, 6) of the error of the position, metres, and of the attitude as a small turn in body axes,
            radians.
        statistic: sum of squared residuals over their variances; chi-square with `dof` degrees of freedom.
        dof: image coordinates beyond the 6 that a pose needs.
        p_value: probability of a larger statistic.
        mirror: position and quaternion (7,) of the other pose that fits nearly as well (chi-square less than 20
            larger), as a plane seen from afar has one; else None.
    """

    position: FloatArray
    quaternion: FloatArray
    cov: FloatArray
    statistic: float
    dof: int
    p_value: float
    mirror: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class CameraSensor(Sensor):
    """A camera that sees k known points of a body: measurement `u0 v0 u1 v1 ...`, pixels; NaN = not seen.

    The state is the pose of the body in the camera frame (x to the right, y down, z along the optical axis): position
    and rotation vector. The extended, unscented and cubature filters take a motion with 6 axes and the image points
    themselves, however few are seen (`x y z rx ry rz vx vy vz wx wy wz ...`, rates in body axes); a run starts itself
    from three images of at least four points each. `fix` gives the pose of one image.

    Args:
        points: the points in body coordinates (k, 3), metres.
        intrinsics: focal lengths and principal point (fu, fv, cu, cv), pixels, or the camera matrix (3, 3) without
            skew. Lens distortion must have been taken out of the measurements.
        pixel_std: standard deviation of an image coordinate, pixels.

    Raises:
        DimensionError: a shape is another.
        ParameterError: a focal length or `pixel_std` is not positive, or the camera matrix is none.

    Reference:
        Hartley, Zisserman (2004), Multiple view geometry in computer vision, chapter 6.

    Example:
        >>> import trackrs as tr
        >>> cross = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [-0.1, 0, 0], [0, -0.1, 0]]
        >>> camera = tr.CameraSensor(cross, intrinsics=(1000, 1000, 640, 480), pixel_std=0.3)
        >>> image = camera.observe([0.0, 0.0, 1.0, 0.5, 0.0, 0.0])
        >>> image[:4]
        array([640., 480., 740., 480.])
        >>> camera.fix(image).position.round(6) + 0.0
        array([0., 0., 1.])
    """

    points: ArrayLike
    intrinsics: ArrayLike
    pixel_std: float

    def __post_init__(self) -> None:
        """Copy the arrays and build the model."""
        points = frozen_array(self.points, "points", 2)
        given = frozen_array(self.intrinsics, "intrinsics", np.ndim(self.intrinsics))
        if given.shape not in {(4,), (3, 3)}:
            msg = f"intrinsics must be (fu, fv, cu, cv) or a camera matrix (3, 3), got shape {given.shape}"
            raise DimensionError(msg)
        matrix = given
        if given.shape == (4,):
            fu, fv, cu, cv = given
            matrix = np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])
        core = _trackrs.Sensor.camera(points, matrix, float(self.pixel_std))
        for name, value in {"points": points, "intrinsics": given, "_core": core}.items():
            object.__setattr__(self, name, value)

    def fix(self, values: ArrayLike) -> PoseFix:
        """Return the pose that one image (2k,) gives by itself; four points that are not on one line will do.

        Gauss-Newton from closed-form poses, for a plane from both of its attitudes; of the solutions the one with the
        least residuals. The covariance is the Cramér-Rao bound there.

        Args:
            values: image coordinates, pixels; NaN = not seen. A point of which one coordinate is missing counts with
                the other.

        Raises:
            UnobservableError: fewer than four points seen whole, collinear points, or no convergence; the message names
                them.
            NonFiniteError: a value is infinite.
            DimensionError: there are not 2k values.

        Reference:
            Closed form: scaled orthography, DeMenthon, Davis (1995); of a plane, Oberkampf, DeMenthon, Davis (1996).
        """
        return PoseFix(**freeze_columns(self._core.pose_fix(array(values, "values", 1))))
