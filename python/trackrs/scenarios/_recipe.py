"""Scenarios are pickled as the call that made them."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R", bound="Recalled")


class Recalled:
    """A scenario that knows the call that made it."""

    __slots__ = ("_recipe",)
    _recipe: tuple[str, tuple[Any, ...], dict[str, Any]]

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        """Pickle the call."""
        return (_make, self._recipe)


def remembered(make: Callable[P, R]) -> Callable[P, R]:
    """Let what a function returns know the call that made it."""

    @functools.wraps(make)
    def made(*args: P.args, **kwargs: P.kwargs) -> R:
        scenario = make(*args, **kwargs)
        object.__setattr__(scenario, "_recipe", (make.__name__, args, kwargs))
        return scenario

    return made


def _make(name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> object:
    from trackrs import scenarios  # noqa: PLC0415 (which imports this module)

    return getattr(scenarios, name)(*args, **kwargs)
