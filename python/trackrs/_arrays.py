"""Arrays at the edge: everything that enters becomes C-contiguous float64 here, everything that leaves is read-only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from trackrs.errors import DimensionError, ParameterError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = "NDArray[np.float64]"
IntArray: TypeAlias = "NDArray[np.int64]"
_FLOAT = np.dtype(np.float64)


def array(value: ArrayLike, name: str, ndim: int) -> FloatArray:
    """Return `value` as a C-contiguous float64 array of `ndim` dimensions.

    Raises:
        DimensionError: it has another number of dimensions, or is not an array of numbers.
    """
    # What is as it must be already goes straight through: small problems cost less than these conversions.
    if type(value) is np.ndarray and value.dtype is _FLOAT and value.ndim == ndim and value.flags.c_contiguous:
        return value
    try:
        out = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        msg = f"{name} must be an array of numbers: {error}"
        raise DimensionError(msg) from None
    if np.ndim(value) != ndim:
        msg = f"{name} must have {ndim} dimension{'s' * (ndim != 1)}, got shape {np.shape(value)}"
        raise DimensionError(msg)
    return out


def frozen(value: NDArray[Any]) -> NDArray[Any]:
    """Make an array that nobody else holds read-only and return it."""
    value.setflags(write=False)
    return value


def freeze_columns(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Make every array of a result read-only."""
    return {key: frozen(value) if isinstance(value, np.ndarray) else value for key, value in columns.items()}


def frozen_array(value: ArrayLike, name: str, ndim: int) -> FloatArray:
    """Return a read-only float64 copy of `value` with `ndim` dimensions."""
    return frozen(array(value, name, ndim).copy())


def for_each(matrices: FloatArray, count: int) -> FloatArray:
    """Return `count` matrices (count, m, n), of which one was given if all are the same; it takes no memory then."""
    return np.broadcast_to(frozen(matrices), (count, *matrices.shape[1:]))


def without_repeats(matrices: FloatArray) -> FloatArray:
    """Return one of matrices that are all one and the same in memory, others as they are."""
    return matrices[:1] if matrices.strides[0] == 0 else matrices


def each(convert: Callable[[FloatArray], FloatArray], value: ArrayLike, name: str, ndim: int = 2) -> FloatArray:
    """Call `convert` with an array of `ndim` dimensions; one point or matrix goes in and comes out as itself."""
    if np.ndim(value) == ndim - 1:
        one = convert(array(value, name, ndim - 1)[np.newaxis])
        return frozen(one.reshape(one.shape[1:]))
    return frozen(convert(array(value, name, ndim)))


def per_axis(value: float | Sequence[float], dims: int, name: str) -> list[float]:
    """Return one value per axis from a scalar or a sequence of length `dims`.

    Raises:
        ParameterError: `dims` is below 1.
        DimensionError: the sequence has another length.
    """
    if dims < 1:
        msg = f"dims = {dims} is invalid: must be at least 1"
        raise ParameterError(msg)
    values = np.asarray(value, dtype=np.float64)
    if values.ndim == 0:
        return [float(values)] * dims
    if values.shape != (dims,):
        msg = f"{name} must be a number or {dims} numbers, got shape {values.shape}"
        raise DimensionError(msg)
    return [float(v) for v in values]
