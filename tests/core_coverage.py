"""What `make coverage` says: how much of the core its Rust tests reach, from what `llvm-cov export` has written.

A branch is a condition with two outcomes, each of which counts. A place in the source counts once, however often it was
compiled: a generic function or a kernel for several widths of registers is reached where one of its copies is. Tests
that stand in the sources do not count.
"""

from __future__ import annotations

import json
import sys
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

BAR = 90.0
SOURCES = "/rust/trackrs/src/"


def part(file: str) -> str | None:
    """The file below the core's sources."""
    _, found, name = file.partition(SOURCES)
    return name if found else None


def outcomes(export: dict[str, Any]) -> dict[str, dict[tuple[int, ...], bool]]:
    """For every file whether each outcome of each of its branches was seen."""
    found: dict[str, dict[tuple[int, ...], bool]] = defaultdict(dict)
    for function in export["functions"]:
        if "5tests" in function["name"]:  # the mangled name of a module `tests`
            continue
        for *place, taken, not_taken, file, _, _ in function["branches"]:
            name = part(function["filenames"][file])
            if name is None:
                continue
            seen = found[name]
            for outcome, count in enumerate((taken, not_taken)):
                key = (*place, outcome)
                seen[key] = seen.get(key, False) or count > 0
    return found


def main(path: str, details: bool) -> int:
    export = json.loads(Path(path).read_text())["data"][0]
    every, reached = Counter[str](), Counter[str]()
    for name, seen in sorted(outcomes(export).items()):
        module = name.split("/")[0].removesuffix(".rs")
        every[module] += len(seen)
        reached[module] += sum(seen.values())
        missing = sorted({key[0] for key, was in seen.items() if not was})
        if details and missing:
            print(f"{name}: {sum(seen.values())} of {len(seen)}; lines {', '.join(map(str, missing))}")
    lines = Counter[str]()
    for file in export["files"]:
        if part(file["filename"]) is not None:
            lines.update({key: file["summary"]["lines"][key] for key in ("count", "covered")})

    def row(name: str, part: int, whole: int) -> str:
        return f"{name:12} {part:6} of {whole:6}  {100 * part / max(whole, 1):5.1f} %"

    for module in sorted(every):
        print(row(module, reached[module], every[module]))
    print(row("lines", lines["covered"], lines["count"]))
    print(f"{row('branches', reached.total(), every.total())}, at least {BAR} % are asked for")
    total = 100 * reached.total() / max(every.total(), 1)
    return 0 if total >= BAR else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], "--details" in sys.argv[2:]))
