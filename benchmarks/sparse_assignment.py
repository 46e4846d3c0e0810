"""Workload of the peers' benchmark that it does not have: assignment where few pairs are allowed, W9sparse.

n rows and columns, five columns per row: the diagonal, so that every row finds one, and four at random. The dense
solvers get the full matrix with a large cost for the pairs that are not allowed. `run.py` puts this file among the
peers' and runs it as one of them.
"""

from __future__ import annotations

import numpy as np
from common import main_args, peer, run_workload, try_import_trackrs, wanted
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

PER_ROW = 5
FORBIDDEN = 1e3  # above what any path of allowed pairs can save, below what would spoil the sums


def inputs(size: str) -> dict:
    """Costs in (0, 1]; the sparse form has no zeros, which SciPy would take for forbidden pairs."""
    n = int(size)
    rng = np.random.default_rng(950 + n)
    rows = np.repeat(np.arange(n), PER_ROW)
    columns = rng.integers(0, n, n * PER_ROW)
    columns[::PER_ROW] = np.arange(n)
    pairs = np.unique(rows * n + columns)
    costs = 1.0 - rng.uniform(0.0, 1.0, len(pairs))
    matrix = csr_array((costs, (pairs // n, pairs % n)), shape=(n, n))
    best = matrix[min_weight_full_bipartite_matching(matrix)].sum()
    return {"n": n, "rows": pairs // n, "columns": pairs % n, "costs": costs, "matrix": matrix, "best": best}


def full(d: dict) -> np.ndarray:
    """The matrix that the dense solvers get; made once."""
    if "full" not in d:
        d["full"] = np.full((d["n"], d["n"]), FORBIDDEN)
        d["full"][d["rows"], d["columns"]] = d["costs"]
    return d["full"]


@peer("W9sparse", "scipy.min_weight_full_bipartite_matching", "scipy")
def _(d: dict) -> tuple:
    return lambda: min_weight_full_bipartite_matching(d["matrix"]), lambda found: found


@peer("W9sparse", "scipy", "scipy", note="dense")
def _(d: dict) -> tuple:
    costs = full(d)
    return lambda: linear_sum_assignment(costs), lambda found: found


@peer("W9sparse", "lapx.lapjvs", "lapx", note="dense")
def _(d: dict) -> tuple:
    import lap

    costs = full(d)
    return lambda: lap.lapjvs(costs, return_cost=False, jvx_like=True), lambda found: found


@peer("W9sparse", "trackrs", "trackrs")
def _(d: dict) -> tuple:
    import trackrs as tr

    shape = (d["n"], d["n"])

    def run() -> object:
        return tr.association.assign_sparse(d["rows"], d["columns"], d["costs"], shape=shape)

    return run, lambda found: (np.arange(d["n"]), found.columns)


def check(d: dict, found: tuple) -> tuple[bool, str]:
    """Every row has a column of its own, and the sum is the least."""
    rows, columns = (np.asarray(side) for side in found)
    whole = len(rows) == len(set(columns.tolist())) == d["n"]
    return bool(whole and abs(d["matrix"][rows, columns].sum() - d["best"]) < 1e-9), ""


def main() -> None:
    """Run what is asked for."""
    arguments = main_args()
    try_import_trackrs()
    if wanted(arguments, "W9sparse"):
        sizes = arguments.sizes or ["5000"]
        run_workload("W9sparse", sizes, inputs, check, "ms", lambda _d: (1, 1e3), arguments.budget, only=arguments.only)


if __name__ == "__main__":
    main()
