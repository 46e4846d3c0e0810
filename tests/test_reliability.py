"""docs/reliability.md names a test for every fault, and every test it names is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")
NAMED = sorted(set(re.findall(r"`(test_\w+\.py|\w+\.rs)::(\w+)`", PAGE)))


def exists(file: str, name: str) -> bool:
    """Whether a file of that name has a test of that name."""
    if file.endswith(".py"):
        places, pattern = [ROOT / "tests" / file], rf"^def {name}\("
    else:
        places = [*(ROOT / "rust" / "trackrs").rglob(file)]
        pattern = rf"#\[test\]\s+(?:#\[[^\]]*\]\s+)*fn {name}\(|^\s+fn {name}\(|^pub\(crate\) fn {name}\(source: "
    return any(re.search(pattern, place.read_text(encoding="utf-8"), re.MULTILINE) for place in places)


@pytest.mark.parametrize(("file", "name"), NAMED, ids=[f"{file}-{name}" for file, name in NAMED])
def test_every_test_that_is_named_is_there(file, name):
    assert exists(file, name)


def test_a_name_that_is_not_there_is_noticed():
    assert not exists("kalman.rs", "no_such_test")
    assert not exists("test_tracker.py", "test_no_such_thing")


def test_every_fault_and_report_has_a_row_with_a_test_or_says_that_it_is_open():
    tables = re.split(r"^## ", PAGE, flags=re.MULTILINE)
    for title, count in (("Faults", 26), ("Reports against others", 41)):
        (table,) = (part for part in tables if part.startswith(title))
        rows = re.findall(r"^\| (\d+) \|[^|]*\|(.*)\|$", table, re.MULTILINE)
        assert [int(number) for number, _ in rows] == list(range(1, count + 1))
        assert all("`" in shown or "open" in shown for _, shown in rows)
