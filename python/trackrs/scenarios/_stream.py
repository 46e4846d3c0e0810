"""The numbers of streams."""

from __future__ import annotations

import operator

from trackrs.errors import ParameterError


def stream_number(name: str, value: int) -> int:
    """Return the number of a stream."""
    number = operator.index(value)
    if 0 <= number < 2**64:
        return number
    msg = f"{name} = {value} is invalid: must be a whole number from 0 to 2**64 - 1"
    raise ParameterError(msg)
