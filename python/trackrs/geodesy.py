"""Positions on the Earth: WGS-84, Earth-centred and local coordinates, and the similarity that ties two frames.

Angles are radians, everything else metres. A geodetic position is latitude, longitude, height over the ellipsoid, in
this order. Functions take one point (3,) or many (k, 3) and return the same shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, each, freeze_columns, frozen
from trackrs.errors import DimensionError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "LocalFrame",
    "PlacedArray",
    "Points",
    "Similarity",
    "ecef_to_geodetic",
    "fit_similarity",
    "geodetic_to_ecef",
    "place_array",
]


def _position(value: ArrayLike, name: str) -> tuple[float, float, float]:
    out = array(value, name, 1)
    if out.shape != (3,):
        msg = f"{name} must be latitude, longitude and height, got shape {out.shape}"
        raise DimensionError(msg)
    return (float(out[0]), float(out[1]), float(out[2]))


def geodetic_to_ecef(positions: ArrayLike) -> FloatArray:
    """Return the Earth-centred, Earth-fixed coordinates of WGS-84 positions.

    Args:
        positions: latitude, longitude (radians), height (metres); (3,) or (k, 3).

    Returns:
        x, y, z in metres, of the same shape; z points to the north pole, x to latitude and longitude 0.

    Raises:
        ParameterError: a latitude is beyond ±π/2 or a longitude beyond ±2π (degrees, perhaps, or the two swapped), or
            a value is not finite.
        DimensionError: the shape is another.

    Reference:
        NIMA TR8350.2 (2000), Department of Defense World Geodetic System 1984.

    Example:
        >>> import numpy as np
        >>> from trackrs import geodesy
        >>> geodesy.geodetic_to_ecef([0.0, np.pi, 0.0]).round(3) + 0.0
        array([-6378137.,        0.,        0.])
    """
    return each(_trackrs.geodetic_to_ecef, positions, "positions")


def ecef_to_geodetic(points: ArrayLike) -> FloatArray:
    """Return the WGS-84 positions of Earth-centred, Earth-fixed points.

    A closed form, better than a micrometre from the Earth's interior to beyond the geostationary orbit. Within 43 km of
    the Earth's centre several positions name one point; this returns the one under the nearest surface.

    Args:
        points: x, y, z in metres; (3,) or (k, 3).

    Returns:
        Latitude in ±π/2, longitude in ±π (0 on the Earth's axis), height in metres; of the same shape.

    Raises:
        NonFiniteError: a coordinate is NaN or infinite.
        ParameterError: a coordinate is beyond 1e15 m.
        DimensionError: the shape is another.

    Reference:
        Vermeille (2011), An analytical method to transform geocentric into geodetic coordinates.

    Example:
        >>> from trackrs import geodesy
        >>> geodesy.ecef_to_geodetic([0.0, 6378147.0, 0.0]).round(6)
        array([ 0.      ,  1.570796, 10.      ])
    """
    return each(_trackrs.ecef_to_geodetic, points, "points")


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """A Cartesian frame that touches the Earth at its origin.

    Neither the antimeridian nor a pole is a seam in it. Down is depth below the tangent plane: 10 km from the origin
    the sea surface lies 8 m deeper.

    Args:
        origin: latitude, longitude (radians), height (metres).
        axes: "ned" (north, east, down) or "enu" (east, north, up).

    Raises:
        ParameterError: the origin is not in radians, or `axes` is another word.

    Reference:
        Groves (2013), Principles of GNSS, inertial, and multisensor integrated navigation systems, section 2.4.

    Example:
        >>> import numpy as np
        >>> from trackrs import geodesy
        >>> frame = geodesy.LocalFrame(np.radians([63.4, 10.4, 0.0]), axes="enu")
        >>> frame.from_geodetic([*np.radians([63.4, 10.4]), 25.0]).round(6) + 0.0
        array([ 0.,  0., 25.])
    """

    origin: tuple[float, float, float]
    axes: Literal["ned", "enu"] = "ned"

    def __init__(self, origin: ArrayLike, axes: Literal["ned", "enu"] = "ned") -> None:
        """Check the origin."""
        object.__setattr__(self, "origin", _position(origin, "origin"))
        object.__setattr__(self, "axes", axes)
        _ = self._core

    @property
    def _core(self) -> _trackrs.LocalFrame:
        return _trackrs.LocalFrame(*self.origin, self.axes)

    @property
    def rotation(self) -> FloatArray:
        """The rotation from Earth-centred to local axes (3, 3); its rows are the local axes."""
        return frozen(self._core.rotation())

    def from_geodetic(self, positions: ArrayLike) -> FloatArray:
        """Return local coordinates, metres, of latitudes, longitudes (radians) and heights; (3,) or (k, 3).

        Raises:
            ParameterError: a latitude is beyond ±π/2, a longitude beyond ±2π, or a value is not finite.
        """
        return each(self._core.from_geodetic, positions, "positions")

    def to_geodetic(self, points: ArrayLike) -> FloatArray:
        """Return latitude, longitude (radians) and height of local points, metres; (3,) or (k, 3).

        Raises:
            NonFiniteError: a coordinate is NaN or infinite.
        """
        return each(self._core.to_geodetic, points, "points")

    def from_ecef(self, points: ArrayLike) -> FloatArray:
        """Return local coordinates of Earth-centred points, metres; (3,) or (k, 3).

        Raises:
            NonFiniteError: a coordinate is NaN or infinite.
        """
        return each(self._core.from_ecef, points, "points")

    def to_ecef(self, points: ArrayLike) -> FloatArray:
        """Return Earth-centred coordinates of local points, metres; (3,) or (k, 3).

        Raises:
            NonFiniteError: a coordinate is NaN or infinite.
        """
        return each(self._core.to_ecef, points, "points")

    def cov_from_ecef(self, covs: ArrayLike) -> FloatArray:
        """Return the covariances of local coordinates from those of Earth-centred ones; (3, 3) or (k, 3, 3), m².

        Raises:
            ParameterError: one is not symmetric or not positive semidefinite.
        """
        return each(self._core.cov_from_ecef, covs, "covs", 3)

    def cov_to_ecef(self, covs: ArrayLike) -> FloatArray:
        """Return the covariances of Earth-centred coordinates from those of local ones; (3, 3) or (k, 3, 3), m².

        Raises:
            ParameterError: one is not symmetric or not positive semidefinite.
        """
        return each(self._core.cov_to_ecef, covs, "covs", 3)


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Points with covariances.

    Attributes:
        positions: (k, 3) metres.
        covs: (k, 3, 3) m².
    """

    positions: FloatArray
    covs: FloatArray

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.positions)

    @property
    def std(self) -> FloatArray:
        """Standard deviation of every coordinate (k, 3), metres."""
        return np.sqrt(np.diagonal(self.covs, axis1=1, axis2=2))


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """Takes points from one frame to another: p′ = translation + scale · rotation · p.

    Attributes:
        scale: s.
        rotation: R, (3, 3).
        translation: t, (3,) metres.
        rotation_vector: R as axis times angle (3,), radians, the angle in [0, π].
        cov: (7, 7) covariance of the errors of t (metres), of ln s, and of R as the vector ω (radians) of a small
            rotation in the target frame, exp([ω]×) R.
        residuals: target minus transformed source (k, 3), metres; NaN for points that took no part.
        variance: a-posteriori variance of an observation of weight 1; m² without weights.
        dof: redundancy, 3k - 7 for k common points.
        centre, image: centroid of the common points in the source frame, and its image (3,), metres.
        centred_cov: as `cov`, with the error of `image` in place of that of t: better conditioned far from the origin.
    """

    scale: float
    rotation: FloatArray
    translation: FloatArray
    rotation_vector: FloatArray
    cov: FloatArray
    residuals: FloatArray
    variance: float
    dof: int
    centre: FloatArray
    image: FloatArray
    centred_cov: FloatArray

    @property
    def parameters(self) -> FloatArray:
        """The seven parameters: translation, ln scale, rotation vector. `cov` says how its last three errors count."""
        return frozen(np.array([*self.translation, np.log(self.scale), *self.rotation_vector]))

    def apply(self, points: ArrayLike) -> FloatArray:
        """Return the images of points (3,) or (k, 3), metres.

        Raises:
            NonFiniteError: a coordinate is NaN or infinite.
        """
        return each(lambda rows: self.propagate(rows).positions, points, "points")

    def propagate(self, points: ArrayLike, covs: ArrayLike | None = None) -> Points:
        """Return the images of points with their covariances, the uncertainty of the similarity included.

        The covariances hold point by point; between points the similarity's error is shared.

        Args:
            points: (k, 3) metres.
            covs: their own covariances (k, 3, 3), m²; zero where none are given.

        Raises:
            ParameterError: a covariance is not symmetric or not positive semidefinite.
            DimensionError: the shapes do not agree.
        """
        rows = array(points, "points", 2)
        own = np.zeros((len(rows), 3, 3)) if covs is None else array(covs, "covs", 3)
        out = _trackrs.apply_similarity(self.scale, self.rotation, self.centre, self.image, self.centred_cov, rows, own)
        return Points(**freeze_columns(out))


def _similarity(columns: dict[str, Any]) -> Similarity:
    return Similarity(**freeze_columns(columns))


def fit_similarity(source: ArrayLike, target: ArrayLike, weights: ArrayLike | None = None) -> Similarity:
    """Return the seven-parameter similarity that takes `source` to `target` with least squared residuals.

    Args:
        source: common points in one frame (k, 3), metres, three or more and not on one line.
        target: the same points in the other frame (k, 3), metres. Both frames are right-handed.
        weights: per point, 1/variance of its target coordinates up to a common factor (k,); equal where none are given.

    Returns:
        The similarity with residuals, a-posteriori variance and first-order covariance.

    Raises:
        ParameterError: fewer than three points, collinear points, a weight that is not positive.
        NonFiniteError: a coordinate is NaN or infinite.
        DimensionError: the shapes do not agree.

    Reference:
        Umeyama (1991), Least-squares estimation of transformation parameters between two point patterns.

    Example:
        >>> import numpy as np
        >>> from trackrs import geodesy
        >>> source = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
        >>> found = geodesy.fit_similarity(source, 2.0 * source + [5.0, 6.0, 7.0])
        >>> round(found.scale, 9), found.apply([1.0, 1.0, 1.0]).round(9)
        (2.0, array([7., 8., 9.]))
    """
    weights_ = None if weights is None else array(weights, "weights", 1)
    return _similarity(_trackrs.fit_similarity(array(source, "source", 2), array(target, "target", 2), weights_))


@dataclass(frozen=True, slots=True, eq=False)
class PlacedArray:
    """An array in the common frame.

    Attributes:
        positions: every element in north, east, down about the origin (k, 3), metres.
        covs: their covariances (k, 3, 3), m². Errors of different elements are correlated; these are the blocks.
        similarity: from the array's own frame to the common one. Its covariance follows from the standard deviations of
            the fixes; its residuals are fix minus placed element (k, 3), NaN without a fix.
        chi_square: of the residuals; chi-square with `dof` degrees of freedom if survey and standard deviations are
            right. Far above that, one of them is not, or the array's frame is left-handed.
        dof: 3m - 7 for m fixes.
        survey_std: (k,) metres: of every element's position in the direction where it is largest, a bound for the range
            to it from anywhere. `RangeArray(placed.positions, range_std, survey_std=placed.survey_std)` takes it into
            account.
    """

    positions: FloatArray
    covs: FloatArray
    similarity: Similarity
    chi_square: float
    dof: int
    survey_std: FloatArray


def place_array(elements: ArrayLike, fixes: ArrayLike, std: ArrayLike, origin: ArrayLike) -> PlacedArray:
    """Place an array, surveyed in its own frame, in north, east, down about `origin` by the GPS fixes of its elements.

    Args:
        elements: every element in the array's own right-handed frame (k, 3), metres.
        fixes: latitude, longitude (radians), height (metres) of every element (k, 3); a row of NaN where there is no
            fix. Three or more are needed, of elements that are not on one line.
        std: standard deviations of the fixes, metres: a number, one each to the north, to the east and downwards (3,),
            or one row per element (k, 3).
        origin: latitude, longitude (radians), height (metres) of the origin of the common frame.

    Returns:
        Coordinates of all elements, z = down, and the covariance of each. The survey itself counts as exact.

    Raises:
        ParameterError: too few or collinear fixes, degrees instead of radians, or a standard deviation that is not
            positive.
        DimensionError: the shapes do not agree.

    Reference:
        Umeyama (1991), as in `fit_similarity`; then Gauss-Newton steps, because heights are worse than the rest.

    Example:
        >>> import numpy as np
        >>> from trackrs import geodesy
        >>> origin = [0.95, 0.18, 0.0]
        >>> elements = np.array([[0.0, 0.0, 0.0], [80.0, 0.0, 5.0], [0.0, 60.0, 5.0], [40.0, 30.0, 20.0]])
        >>> fixes = geodesy.LocalFrame(origin).to_geodetic(elements + [10.0, 20.0, 30.0])
        >>> heard = np.where([[True], [True], [True], [False]], fixes, np.nan)
        >>> placed = geodesy.place_array(elements, heard, [0.02, 0.02, 0.05], origin)
        >>> placed.positions[3].round(6), placed.dof
        (array([50., 50., 50.]), 2)
    """
    elements_, fixes_ = array(elements, "elements", 2), array(fixes, "fixes", 2)
    shape = np.shape(std)
    if shape not in {(), (3,), (len(fixes_), 3)}:
        msg = f"std must be a number, 3 numbers or one row of 3 per element, got shape {shape}"
        raise DimensionError(msg)
    stds = np.ascontiguousarray(np.broadcast_to(array(std, "std", len(shape)), (len(fixes_), 3)))
    out = _trackrs.place_array(elements_, fixes_, stds, _position(origin, "origin"))
    similarity = _similarity(out["similarity"])
    columns = freeze_columns(out["elements"])
    return PlacedArray(
        similarity=similarity,
        chi_square=out["chi_square"],
        dof=similarity.dof,
        survey_std=frozen(out["survey_std"]),
        **columns,
    )
