"""How far belief propagation is from the exact marginals: total variation over 1,000 problems, everything gated.

python benchmarks/association_quality.py            # prints the table and puts it into docs/association.md
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

import trackrs as tr

PAGE = Path(__file__).resolve().parent.parent / "docs" / "association.md"
BEGIN, END = "<!-- measured: begin -->\n", "<!-- measured: end -->"
PROBLEMS, SIZES, SEED = 1000, range(8, 13), 5
P_D, CLUTTER = 0.9, 1e-2


def spread(rng: np.random.Generator, tracks: int, reports: int) -> np.ndarray:
    """Weights of reports at independent distances, as in the benchmark of the peers."""
    densities = np.exp(-0.75 * rng.chisquare(2, (tracks, reports))) / (4 * np.pi)
    return np.concatenate([np.full((tracks, 1), 1 - P_D), P_D * densities / CLUTTER], axis=1)


def crowd(rng: np.random.Generator, tracks: int, reports: int) -> np.ndarray:
    """Weights of a crowd in the plane: targets some sigma apart, their reports, and clutter among them."""
    places = rng.normal(size=(tracks, 2)) * rng.uniform(0.3, 2.0)
    seen = places[rng.random(tracks) < P_D][:reports]
    clutter = rng.normal(size=(reports - len(seen), 2)) * 2.0
    values = np.concatenate([seen + rng.normal(size=seen.shape), clutter])
    squared = ((places[:, None] - values[None]) ** 2).sum(-1) / 2.0
    return np.concatenate([np.full((tracks, 1), 1 - P_D), P_D * np.exp(-0.5 * squared) / (4 * np.pi) / CLUTTER], axis=1)


def uniform(rng: np.random.Generator, tracks: int, reports: int) -> np.ndarray:
    """Weights of report that are all about as likely."""
    return np.concatenate([np.full((tracks, 1), 1 - P_D), rng.random((tracks, reports))], axis=1)


def distances(make, approximate) -> tuple[np.ndarray, np.ndarray]:
    """Return per problem the total variation of its worst track and of its mean track."""
    worst, mean = [], []
    for run in range(PROBLEMS):
        rng = np.random.default_rng([SEED, run])
        tracks = SIZES[run % len(SIZES)]
        weights = make(rng, tracks, SIZES[int(rng.integers(len(SIZES)))])
        exact = tr.association.marginals(weights)
        other = approximate(weights)
        if exact.method != "exact":
            msg = f"{tracks} tracks are beyond the budget: there is nothing to compare with"
            raise RuntimeError(msg)
        tv = 0.5 * np.abs(exact.probabilities - other.probabilities).sum(axis=1)
        worst.append(tv.max())
        mean.append(tv.mean())
    return np.array(worst), np.array(mean)


def main() -> None:
    """Measure, print, write."""
    kinds = {"independent distances": spread, "crowd in the plane": crowd, "all about as likely": uniform}
    lines = [
        f"Measured over {PROBLEMS} problems of each kind, 8 × 8 to 12 × 12, everything gated, by",
        "`benchmarks/association_quality.py`: total variation ½ Σ_j |β - β_exact| of what is used beyond the budget,",
        "and the time of 30 × 30 on one core.",
        "",
        "| weights | worst track: median | 95 % | largest | mean track: median | 30 × 30 |",
        "|---|---|---|---|---|---|",
    ]
    for name, make in kinds.items():
        worst, mean = distances(make, lambda weights: tr.association.marginals(weights, budget=0))
        large = make(np.random.default_rng(SEED), 30, 30)
        times = []
        for _ in range(5):
            start = time.process_time()
            found = tr.association.marginals(large)
            times.append(time.process_time() - start)
        values = [np.median(worst), np.quantile(worst, 0.95), worst.max(), np.median(mean)]
        row = [name, *(f"{value:.4f}" for value in values), f"{1e3 * min(times):.1f} ms, {found.method}"]
        lines.append("| " + " | ".join(row) + " |")
    print("\n".join(lines))
    text = PAGE.read_text()
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    PAGE.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + after)


if __name__ == "__main__":
    main()
