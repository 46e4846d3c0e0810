"""Values: what is pickled by its arguments and told apart by its content."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


class Value:
    """A dataclass that is pickled as the arguments it was made with: what it has compiled is made anew."""

    __slots__ = ()

    def __reduce__(self) -> tuple[object, tuple[object, dict[str, object]]]:
        """Pickle the arguments, and nothing that could run."""
        return (_made, (type(self), _arguments(self)))


def _arguments(value: Any) -> dict[str, Any]:  # noqa: ANN401 (any dataclass)
    return {item.name: getattr(value, item.name) for item in fields(value) if item.init}


def _made(kind: type, arguments: dict[str, Any]) -> object:
    return kind(**arguments)


def digest(value: object) -> str:
    """Return a hexadecimal number that is the same for the same content, in every process.

    Raises:
        TypeError: the content cannot be told, as that of a function without a name.
    """
    sponge = hashlib.sha256()
    _feed(sponge, value)
    return sponge.hexdigest()


def _feed(sponge: Any, value: object) -> None:  # noqa: ANN401 (hashlib's object has no public type)
    def tag(text: str) -> None:
        sponge.update(f"{len(text)}:{text}".encode())

    match value:
        case None | bool() | int() | float() | str():
            tag(f"{type(value).__name__} {value!r}")
        case bytes():
            tag("bytes")
            sponge.update(hashlib.sha256(value).digest())
        case np.generic():
            _feed(sponge, value.item())
        case np.ndarray():
            tag(f"array {value.dtype.str} {value.shape}")
            sponge.update(np.ascontiguousarray(value).tobytes())
        case Mapping():
            tag(f"map {len(value)}")
            for key, item in value.items():
                _feed(sponge, key)
                _feed(sponge, item)
        case Sequence():
            tag(f"sequence {len(value)}")
            for item in value:
                _feed(sponge, item)
        case _ if hasattr(value, "_recipe"):
            _feed(sponge, value._recipe)
        case _ if is_dataclass(value) and not isinstance(value, type):
            tag(type(value).__qualname__)
            _feed(sponge, _arguments(value))
        case _ if hasattr(value, "to_bytes"):
            _feed(sponge, value.to_bytes())
        case _ if hasattr(value, "__qualname__"):
            tag(f"{value.__module__}.{value.__qualname__}")
        case _:
            msg = f"cannot tell the content of {value!r}"
            raise TypeError(msg)
