"""The numbers of streams."""

from __future__ import annotations

import operator

from trackrs.errors import ParameterError


def stream_number(name: str, value: int) -> int:
    """Return the number of a stream."""
    try:
        number = operator.index(value)
    except TypeError:
        msg = f"{name} must be a whole number, got {value!r}"
        raise TypeError(msg) from None
    if 0 <= number < 2**64:
        return number
    msg = f"{name} = {value!r} is invalid: must be a whole number from 0 to 2**64 - 1"
    raise ParameterError(msg)
