"""Scenarios are pickled as the call that made them."""

from __future__ import annotations

import copy
import functools
import inspect
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R", bound="Recalled")


class Recalled:
    """A scenario that knows the call that made it."""

    __slots__ = ("_recipe",)
    _recipe: tuple[str, dict[str, Any]]

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        """Pickle the call."""
        return (_make, self._recipe)


def remembered(make: Callable[P, R]) -> Callable[P, R]:
    """Let what a function returns know the call that made it."""
    signature = inspect.signature(make)

    @functools.wraps(make)
    def made(*args: P.args, **kwargs: P.kwargs) -> R:
        scenario = make(*args, **kwargs)
        # All arguments by name, so that the same call is the same recipe however it was written; copies, because a list
        # may change later.
        call = signature.bind(*args, **kwargs)
        call.apply_defaults()
        object.__setattr__(scenario, "_recipe", (make.__name__, copy.deepcopy(call.arguments)))
        return scenario

    return made


def _make(name: str, arguments: dict[str, Any]) -> object:
    from trackrs import scenarios  # noqa: PLC0415 (which imports this module)

    return getattr(scenarios, name)(**arguments)
