"""Matrices of mpmath numbers as lists of rows: what the textbook formulas of the certified problems need, no more."""

from __future__ import annotations

from mpmath import mp, mpf


def exact(value):
    """The same structure with every float as the number that it is; integers, strings and None stay."""
    if isinstance(value, dict):
        return {key: exact(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [exact(item) for item in value]
    return mpf(value) if isinstance(value, float) else value


def eye(n):
    return [[mpf(i == j) for j in range(n)] for i in range(n)]


def zeros(n, m):
    return [[mpf(0)] * m for _ in range(n)]


def diag(values):
    out = zeros(len(values), len(values))
    for i, value in enumerate(values):
        out[i][i] = value
    return out


def transpose(a):
    return [list(row) for row in zip(*a, strict=True)]


def times(*factors):
    """The product of matrices, the last of which may be a vector."""
    first, *rest = factors
    for b in rest:
        if isinstance(b[0], list):
            columns = transpose(b)
            first = [[dot(row, column) for column in columns] for row in first]
        else:
            first = [dot(row, b) for row in first]
    return first


def dot(a, b):
    return mp.fdot(a, b)


def add(a, b, share=1):
    """A + share B of vectors or matrices."""
    if isinstance(a[0], list):
        return [add(x, y, share) for x, y in zip(a, b, strict=True)]
    return [x + share * y for x, y in zip(a, b, strict=True)]


def scaled(a, factor):
    if isinstance(a, list):
        return [scaled(x, factor) for x in a]
    return a * factor


def outer(a, b):
    return [[x * y for y in b] for x in a]


def solve(a, b):
    """A⁻¹ B by elimination with partial pivoting; B is a matrix or a vector."""
    if not isinstance(b[0], list):
        return [row[0] for row in solve(a, [[x] for x in b])]
    n = len(a)
    rows = [list(x) + list(y) for x, y in zip(a, b, strict=True)]
    for k in range(n):
        pivot = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[pivot] = rows[pivot], rows[k]
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    for k in reversed(range(n)):
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(k):
            factor = rows[i][k]
            rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[n:] for row in rows]


def cholesky(a):
    """The lower L with A = L Lᵀ."""
    n = len(a)
    low = zeros(n, n)
    for i in range(n):
        for j in range(i + 1):
            rest = a[i][j] - dot(low[i][:j], low[j][:j])
            low[i][j] = mp.sqrt(rest) if i == j else rest / low[j][j]
    return low


def log_det(a):
    return 2 * sum(mp.log(row[i]) for i, row in enumerate(cholesky(a)))


def log_normal(residual, cov):
    """Ln N(residual; 0, cov)."""
    squared = dot(residual, solve(cov, residual))
    return -(squared + log_det(cov) + len(residual) * mp.log(2 * mp.pi)) / 2
