"""What commands print."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Mapping


def note(text: str) -> None:
    """Say on stderr what the user should know although nothing is wrong."""
    click.echo(f"trackrs: note: {text}", err=True)


def print_json(record: Mapping[str, Any], *, err: bool = False) -> None:
    """Print one JSON object, on stderr if so said; numbers that are not finite become null."""
    click.echo(json.dumps(_plain(record), indent=2, allow_nan=False), err=err)


def _plain(value: Any) -> Any:  # noqa: ANN401 (as JSON has it)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def plural(count: int, noun: str) -> str:
    """Return "1 scan" or "2 scans"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def counted(counts: Mapping[str, int]) -> str:
    """Return "3 late_scan, 1 duplicate"."""
    return ", ".join(f"{count} {name}" for name, count in counts.items())
