"""Rotations. What states and measurements hold are rotation vectors: axis times angle, radians, body to frame.

All functions take one rotation or rows of them, and return the same; NaN in, NaN out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trackrs import _trackrs
from trackrs._arrays import FloatArray, array, each
from trackrs.errors import DimensionError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "angles_from_vectors",
    "between",
    "quaternions_from_vectors",
    "turned",
    "vectors_from_angles",
    "vectors_from_quaternions",
]


def vectors_from_quaternions(quaternions: ArrayLike) -> FloatArray:
    """Return the rotation vectors, no longer than pi, of unit quaternions w, x, y, z (Hamilton) of either sign.

    Args:
        quaternions: (4,) or (k, 4). Their norms must be 1 within 0.01.

    Raises:
        ParameterError: a quaternion is zero or far from norm 1; the message names its row.
        NonFiniteError: one is infinite.
        DimensionError: the shape is another.

    Example:
        >>> from trackrs import rotation
        >>> rotation.vectors_from_quaternions([-0.8, -0.6, 0.0, 0.0]).round(4) + 0.0
        array([1.287, 0.   , 0.   ])
    """
    return each(_trackrs.rotation_vectors, quaternions, "quaternions")


def quaternions_from_vectors(vectors: ArrayLike) -> FloatArray:
    """Return the unit quaternions w, x, y, z of rotation vectors, w not negative.

    Args:
        vectors: (3,) or (k, 3), radians.

    Raises:
        DimensionError: the shape is another.
    """
    return each(_trackrs.rotation_quaternions, vectors, "vectors")


def angles_from_vectors(vectors: ArrayLike) -> FloatArray:
    """Return the angles (alpha, beta, gamma) about x, y and z of rotation vectors, R = Rz(gamma) Ry(beta) Rx(alpha).

    Args:
        vectors: (3,) or (k, 3), radians.

    Returns:
        Radians, beta within ±pi/2; where that is reached alpha is 0.

    Raises:
        DimensionError: the shape is another.

    Example:
        >>> from trackrs import rotation
        >>> rotation.angles_from_vectors(rotation.vectors_from_angles([0.1, 0.2, 0.3])).round(12)
        array([0.1, 0.2, 0.3])
    """
    return each(_trackrs.rotation_angles, vectors, "vectors")


def vectors_from_angles(angles: ArrayLike) -> FloatArray:
    """Return the rotation vectors of angles (alpha, beta, gamma) about x, y and z, R = Rz(gamma) Ry(beta) Rx(alpha).

    Args:
        angles: (3,) or (k, 3), radians.

    Raises:
        DimensionError: the shape is another.
    """
    return each(_trackrs.rotation_from_angles, angles, "angles")


def between(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """Return the turns that lead from `start` to `end`, as rotation vectors in body axes; their lengths are the angles.

    Args:
        start: rotation vectors (3,) or (k, 3), radians.
        end: as many.

    Raises:
        DimensionError: the shapes are others.

    Example:
        >>> from trackrs import rotation
        >>> rotation.between([0.0, 0.0, 3.1], [0.0, 0.0, -3.1]).round(4) + 0.0
        array([0.    , 0.    , 0.0832])
    """
    return each(_trackrs.rotation_between, _pairs(start, end, "start and end"), "start and end")


def turned(start: ArrayLike, turns: ArrayLike) -> FloatArray:
    """Return where the turns lead to from `start`: the reverse of `between`.

    Args:
        start: rotation vectors (3,) or (k, 3), radians.
        turns: as many, in body axes.

    Raises:
        DimensionError: the shapes are others.
    """
    return each(_trackrs.rotation_turned, _pairs(start, turns, "start and turns"), "start and turns")


def _pairs(first: ArrayLike, second: ArrayLike, names: str) -> FloatArray:
    a, b = array(first, names, np.ndim(first)), array(second, names, np.ndim(second))
    if a.shape != b.shape or a.ndim not in {1, 2} or a.shape[-1] != 3:
        msg = f"{names} must both be (3,) or (k, 3), got shapes {a.shape} and {b.shape}"
        raise DimensionError(msg)
    return np.concatenate([a, b], axis=-1)
