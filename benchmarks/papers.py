"""The table of claims in docs/papers.md, from a folder that `trackrs reproduce all` has left.

trackrs reproduce all --runs 200 --out reproduction
python benchmarks/papers.py reproduction
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parent.parent / "docs" / "papers.md"
BEGIN, END = "<!-- claims: written by `python benchmarks/papers.py` -->", "<!-- /claims -->"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def pair(row: dict[str, str], value: str, half: str) -> str:
    return f"{float(row[value]):.4g} ±{float(row[half]):.2g}"


def main() -> None:
    folder = Path(sys.argv[1])
    numbers = rows(folder / "numbers.csv")
    judged = [number for number in numbers if number["agrees"]]
    agree = [number for number in judged if number["agrees"] == "True"]
    differ = [number for number in judged if number["agrees"] == "False"]
    lines = [BEGIN, "", "| paper | claim | verdict | what decides |", "|---|---|---|---|"]
    lines += [
        f"| {row['paper']} | {row['claim']} | **{row['verdict']}** | {row['figure']} |"
        for row in rows(folder / "claims.csv")
    ]
    lines += [
        "",
        f"{len(agree)} of {len(judged)} numbers agree with an independent implementation within 95 % intervals.",
    ]
    if differ:
        lines += ["", "| number that differs | independent | ours |", "|---|---|---|"]
        lines += [
            f"| {row['paper']}: {row['number']} | {pair(row, 'reference', 'reference_half_width')} | "
            f"{pair(row, 'ours', 'half_width')} |"
            for row in differ
        ]
    text = PAGE.read_text(encoding="utf-8")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    PAGE.write_text(before + "\n".join([*lines, "", END]) + after, encoding="utf-8")


if __name__ == "__main__":
    main()
