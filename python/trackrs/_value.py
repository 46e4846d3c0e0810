"""Values: what is pickled by its arguments and told apart by its content."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import fields, is_dataclass
from pathlib import PurePath
from types import CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from trackrs.errors import ParameterError


class Value:
    """A dataclass that is pickled as the arguments it was made with: what it has compiled is made anew."""

    __slots__ = ()

    def __reduce__(self) -> tuple[object, tuple[object, dict[str, object]]]:
        """Pickle the arguments, and nothing that could run."""
        return (_made, (type(self), _arguments(self)))

    def _more(self) -> dict[str, object]:
        """Arguments that are no fields."""
        return {}


def _arguments(value: Any) -> dict[str, Any]:  # noqa: ANN401 (any dataclass)
    more = value._more() if isinstance(value, Value) else {}
    return {item.name: getattr(value, item.name) for item in fields(value) if item.init} | more


def _made(kind: type, arguments: dict[str, Any]) -> object:
    return kind(**arguments)


def digest(value: object) -> str:
    """Return a hexadecimal number that is the same for the same content, in every process.

    Functions and classes outside of trackrs count with their code, which is that of one version of Python; what they
    call does not.

    Raises:
        ParameterError: the content cannot be told.
    """
    sponge = hashlib.sha256()
    try:
        _feed(sponge, value)
    except RecursionError:
        msg = f"the content of {type(value).__name__} cannot be told: something in it refers to itself"
        raise ParameterError(msg) from None
    return sponge.hexdigest()


def _feed(sponge: Any, value: object) -> None:  # noqa: ANN401 (hashlib's object has no public type)
    def tag(text: str) -> None:
        sponge.update(f"{len(text)}:{text}".encode())

    match value:
        case None | bool() | int() | float() | complex() | str() | PurePath():
            tag(f"{type(value).__name__} {value!r}")
        case bytes():
            tag("bytes")
            sponge.update(hashlib.sha256(value).digest())
        case np.generic():
            _feed(sponge, value.item())
        case np.ndarray() if not value.dtype.hasobject:
            tag(f"array {value.dtype.str} {value.shape}")
            sponge.update(np.ascontiguousarray(value).tobytes())
        case Mapping():
            tag(f"map {len(value)}")
            for key, item in value.items():
                _feed(sponge, key)
                _feed(sponge, item)
        case AbstractSet():
            tag(f"set {len(value)}")
            for item in sorted(digest(item) for item in value):
                tag(item)
        case Sequence():
            tag(f"sequence {len(value)}")
            for item in value:
                _feed(sponge, item)
        case FunctionType():
            tag(f"function {value.__module__}.{value.__qualname__}")
            _feed_code(sponge, value.__code__)
            cells = [_content(cell) for cell in value.__closure__ or ()]
            _feed(sponge, [value.__defaults__, value.__kwdefaults__, cells])
        case MethodType():
            _feed(sponge, [value.__func__, value.__self__])
        case functools.partial():
            _feed(sponge, [value.func, value.args, value.keywords])
        case type():
            _feed_class(sponge, value)
        case ModuleType():
            tag(f"module {value.__name__}")
        case _ if hasattr(value, "_recipe"):
            _feed(sponge, value._recipe)
        case _ if is_dataclass(value):
            _feed_class(sponge, type(value))
            _feed(sponge, _arguments(value))
        case _ if hasattr(value, "to_bytes"):
            _feed(sponge, value.to_bytes())
        case _ if hasattr(value, "__qualname__"):
            tag(f"{value.__module__}.{value.__qualname__}")
        case _ if hasattr(value, "__dict__"):
            _feed_class(sponge, type(value))
            _feed(sponge, vars(value))
        case _:
            msg = f"the content of {value!r} cannot be told; make it a dataclass"
            raise ParameterError(msg)


def _content(cell: CellType) -> object:
    try:
        return cell.cell_contents
    except ValueError:  # not yet filled
        return None


def _feed_code(sponge: Any, code: CodeType) -> None:  # noqa: ANN401
    _feed(sponge, [code.co_code, code.co_names, code.co_varnames, code.co_freevars])
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            _feed_code(sponge, constant)
        elif constant is not Ellipsis:
            _feed(sponge, constant)


def _feed_class(sponge: Any, kind: type) -> None:  # noqa: ANN401
    """Its name; of one outside of trackrs also what it defines itself."""
    _feed(sponge, f"class {kind.__module__}.{kind.__qualname__}")
    if kind.__module__.partition(".")[0] in {"trackrs", "builtins", "numpy"}:
        return
    for name, item in sorted(vars(kind).items()):
        if isinstance(item, FunctionType):
            _feed(sponge, name)
            _feed_code(sponge, item.__code__)
