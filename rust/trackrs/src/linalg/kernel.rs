//! The small dense operations of a filter, on slices that already have their size: no memory is taken here.
//!
//! Matrices are row-major. Each product adds multiples of rows of length n to a row, so that the innermost loop runs over
//! contiguous numbers and no sum is reordered: the results are the same bits on every CPU and for every way the loops are
//! compiled. `sized!` calls what is made of them with n as a constant for the sizes that states commonly have. It is the
//! same source, so the results are equal bit for bit; the constant lets the compiler unroll the inner loops.
//!
//! Cholesky row by row: L_ij = (A_ij − Σ_k L_ik L_jk) / L_jj,  L_jj = sqrt(A_jj − Σ_k L_jk²).
//! Reference: Golub, Van Loan (2013), Matrix Computations, §4.2.

/// Calls a kernel `fn name<const N: usize>(n: usize, ...)` with N the first argument where that is a common size, else 0.
/// The kernel begins with `let n = known::<N>(n);`.
macro_rules! sized {
    ($kernel:ident($n:expr $(, $argument:expr)* $(,)?)) => {
        match $n {
            2 => $kernel::<2>(2 $(, $argument)*),
            3 => $kernel::<3>(3 $(, $argument)*),
            4 => $kernel::<4>(4 $(, $argument)*),
            6 => $kernel::<6>(6 $(, $argument)*),
            9 => $kernel::<9>(9 $(, $argument)*),
            18 => $kernel::<18>(18 $(, $argument)*),
            n => $kernel::<0>(n $(, $argument)*),
        }
    };
}
pub(crate) use sized;

/// The size that a kernel was compiled for, or the one it is called with.
#[inline(always)]
pub(crate) fn known<const N: usize>(n: usize) -> usize {
    if N == 0 { n } else { N }
}

/// `row` += `factor` × `other`, two at a time: written so, it becomes vector instructions wherever it is unrolled.
#[inline(always)]
pub(crate) fn add_scaled(row: &mut [f64], factor: f64, other: &[f64]) {
    let size = row.len().min(other.len());
    let (pairs, last) = row[..size].as_chunks_mut::<2>();
    let (other_pairs, other_last) = other[..size].as_chunks::<2>();
    for (x, y) in pairs.iter_mut().zip(other_pairs) {
        *x = [x[0] + factor * y[0], x[1] + factor * y[1]];
    }
    add_part(last, factor, other_last);
}

/// The same for a row whose length is not a constant.
#[inline(always)]
fn add_part(row: &mut [f64], factor: f64, other: &[f64]) {
    for (x, y) in row.iter_mut().zip(other) {
        *x += factor * y;
    }
}

/// `out` = `start` (nothing: zeros) + Σ factor × row over the terms, in their order. A row of a constant length stays in
/// registers until its sum is complete.
#[inline(always)]
pub(crate) fn combine<'a, const N: usize>(
    start: Option<&[f64]>,
    terms: impl Iterator<Item = (f64, &'a [f64])>,
    out: &mut [f64],
) {
    if N > 0
        && let Some(out) = out.first_chunk_mut::<N>()
    {
        let mut sum = start.and_then(<[f64]>::first_chunk).copied().unwrap_or([0.0; N]);
        for (factor, row) in terms {
            if let Some(row) = row.first_chunk::<N>() {
                add_scaled(&mut sum, factor, row);
            }
        }
        *out = sum;
        return;
    }
    match start {
        Some(start) => out.copy_from_slice(start),
        None => out.fill(0.0),
    }
    for (factor, row) in terms {
        add_scaled(out, factor, row);
    }
}

/// `row` += Σ factor × other over the terms, like [`combine`].
#[inline(always)]
pub(crate) fn accumulate<'a, const N: usize>(row: &mut [f64], terms: impl Iterator<Item = (f64, &'a [f64])>) {
    if N > 0
        && let Some(row) = row.first_chunk_mut::<N>()
    {
        let start = *row;
        combine::<N>(Some(&start), terms, row);
        return;
    }
    for (factor, other) in terms {
        add_scaled(row, factor, other);
    }
}

/// `out` (r×n) = A (r×k) B (k×n).
#[inline(always)]
pub(crate) fn multiply<const N: usize>(k: usize, n: usize, a: &[f64], b: &[f64], out: &mut [f64]) {
    for (row, coefficients) in out.chunks_exact_mut(n.max(1)).zip(a.chunks_exact(k.max(1))) {
        let terms = coefficients.iter().copied().zip(b.chunks_exact(n.max(1)));
        combine::<N>(None, terms, row);
    }
}

/// The same for an A of many zeros, whose rows of B are left out.
#[inline(always)]
pub(crate) fn multiply_sparse<const N: usize>(k: usize, n: usize, a: &[f64], b: &[f64], out: &mut [f64]) {
    for (row, coefficients) in out.chunks_exact_mut(n.max(1)).zip(a.chunks_exact(k.max(1))) {
        let terms = coefficients.iter().copied().zip(b.chunks_exact(n.max(1)));
        combine::<N>(None, terms.filter(|&(factor, _)| factor != 0.0), row);
    }
}

/// Adds the lower half of A (n×k) B (k×n) to that of `out`.
#[inline(always)]
pub(crate) fn add_product_lower(k: usize, n: usize, a: &[f64], b: &[f64], out: &mut [f64]) {
    let rows = out.chunks_exact_mut(n.max(1)).zip(a.chunks_exact(k.max(1)));
    for (i, (row, coefficients)) in rows.enumerate() {
        let row = &mut row[..=i];
        for (&factor, other) in coefficients.iter().zip(b.chunks_exact(n.max(1))) {
            add_part(row, factor, other);
        }
    }
}

/// `out` = C + Aᵀ B, C being n×n, A and B k×n.
#[inline(always)]
pub(crate) fn add_transposed_product<const N: usize>(n: usize, c: &[f64], a: &[f64], b: &[f64], out: &mut [f64]) {
    let rows = out.chunks_exact_mut(n.max(1)).zip(c.chunks_exact(n.max(1)));
    for (i, (row, start)) in rows.enumerate() {
        let terms = a.chunks_exact(n.max(1)).zip(b.chunks_exact(n.max(1)));
        combine::<N>(Some(start), terms.map(|(left, right)| (left[i], right)), row);
    }
}

/// `out` = C − Aᵀ B, C being n×n, A and B k×n.
#[inline(always)]
pub(crate) fn subtract_transposed_product<const N: usize>(n: usize, c: &[f64], a: &[f64], b: &[f64], out: &mut [f64]) {
    let rows = out.chunks_exact_mut(n.max(1)).zip(c.chunks_exact(n.max(1)));
    for (i, (row, start)) in rows.enumerate() {
        let terms = a.chunks_exact(n.max(1)).zip(b.chunks_exact(n.max(1)));
        combine::<N>(Some(start), terms.map(|(left, right)| (-left[i], right)), row);
    }
}

/// Σ a_i b_i from the first to the last.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b) {
        sum += x * y;
    }
    sum
}

/// `out` = Aᵀ of an n×n matrix.
#[inline(always)]
pub(crate) fn transpose(n: usize, a: &[f64], out: &mut [f64]) {
    let (a, out) = (&a[..n * n], &mut out[..n * n]);
    for i in 0..n {
        for j in 0..n {
            out[j * n + i] = a[i * n + j];
        }
    }
}

/// Replaces A (n×n) by (A + Aᵀ)/2, so that it is symmetric bit for bit. Half the rounding errors of the two halves:
/// with those of one half alone the Joseph form does not stay definite up to a condition of 1e14.
#[inline(always)]
pub(crate) fn symmetrise(n: usize, a: &mut [f64]) {
    let a = &mut a[..n * n];
    for i in 1..n {
        for j in 0..i {
            let mean = 0.5 * (a[i * n + j] + a[j * n + i]);
            a[i * n + j] = mean;
            a[j * n + i] = mean;
        }
    }
}

/// Makes A (n×n) symmetric bit for bit: its lower half is copied to the upper one.
#[inline(always)]
pub(crate) fn mirror(n: usize, a: &mut [f64]) {
    let a = &mut a[..n * n];
    for i in 1..n {
        for j in 0..i {
            a[j * n + i] = a[i * n + j];
        }
    }
}

/// A covariance is nearly singular where this part or less of a component's variance is left once those before it are known:
/// the condition of its correlation matrix is 1e14 or more then, whatever the units.
pub(crate) const NEARLY_SINGULAR: f64 = 1e-14;

/// Whether `part` or less of a component's variance is left once those before it are known, of a covariance n×n: its pivots d_j
/// (C = L D Lᵀ) against its diagonal. What is exactly known (a row of zeros) does not count, and numbers that are not finite
/// are no matter of condition. `work` is n×n.
#[inline(always)]
pub(crate) fn little_left<const N: usize>(n: usize, part: f64, cov: &[f64], work: &mut [f64]) -> bool {
    let n = known::<N>(n);
    work[..n * n].copy_from_slice(&cov[..n * n]);
    eliminate::<N>(n, part, cov, work)
}

/// Whether the matrix of correlations has an eigenvalue of `part` or less: the same without regard to the order of the
/// components, for what is asked of a covariance that is kept as a matrix. C − part diag C has a pivot of 0 or less then.
#[inline(always)]
pub(crate) fn little_anywhere<const N: usize>(n: usize, part: f64, cov: &[f64], work: &mut [f64]) -> bool {
    let n = known::<N>(n);
    work[..n * n].copy_from_slice(&cov[..n * n]);
    for j in 0..n {
        work[j * n + j] *= 1.0 - part;
    }
    eliminate::<N>(n, 0.0, cov, work)
}

#[inline(always)]
fn eliminate<const N: usize>(n: usize, part: f64, cov: &[f64], work: &mut [f64]) -> bool {
    let n = known::<N>(n);
    let (cov, a) = (&cov[..n * n], &mut work[..n * n]);
    for j in 0..n {
        let pivot = a[j * n + j];
        if pivot <= part * cov[j * n + j] {
            if cov[j * n..(j + 1) * n].iter().all(|&x| x == 0.0) {
                continue;
            }
            return true;
        }
        let inverse = 1.0 / pivot;
        for i in j + 1..n {
            let factor = a[i * n + j] * inverse;
            for k in j + 1..=i {
                a[i * n + k] -= factor * a[k * n + j];
            }
        }
    }
    false
}

/// A pivot that is not positive and finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BadPivot {
    pub(crate) index: usize,
    pub(crate) value: f64,
}

/// Replaces the lower half of A (n×n) by its factor L; above the diagonal nothing is read or written.
#[inline(always)]
pub(crate) fn cholesky(n: usize, a: &mut [f64]) -> Result<(), BadPivot> {
    let a = &mut a[..n * n];
    for i in 0..n {
        for j in 0..=i {
            let sum = (0..j).fold(a[i * n + j], |sum, k| sum - a[i * n + k] * a[j * n + k]);
            if j < i {
                a[i * n + j] = sum / a[j * n + j];
            } else if sum > 0.0 && sum.is_finite() {
                a[j * n + j] = sum.sqrt();
            } else {
                return Err(BadPivot { index: j, value: sum });
            }
        }
    }
    Ok(())
}

/// The rows of `b` (m×w) become those of L⁻¹ B; W is w where that is a constant, else 0.
#[inline(always)]
pub(crate) fn solve_lower<const W: usize>(m: usize, w: usize, l: &[f64], b: &mut [f64]) {
    for i in 0..m {
        let (before, rest) = b.split_at_mut(i * w);
        let row = &mut rest[..w];
        let others = before.chunks_exact(w.max(1)).enumerate();
        accumulate::<W>(row, others.map(|(k, other)| (-l[i * m + k], other)));
        let inverse = 1.0 / l[i * m + i];
        for x in row {
            *x *= inverse;
        }
    }
}

/// The rows of `b` (m×w) become those of L⁻ᵀ B; W as there.
#[inline(always)]
pub(crate) fn solve_upper<const W: usize>(m: usize, w: usize, l: &[f64], b: &mut [f64]) {
    for i in (0..m).rev() {
        let (start, after) = b.split_at_mut((i + 1) * w);
        let row = &mut start[i * w..][..w];
        let others = after.chunks_exact(w.max(1)).enumerate();
        accumulate::<W>(row, others.map(|(k, other)| (-l[(i + 1 + k) * m + i], other)));
        let inverse = 1.0 / l[i * m + i];
        for x in row {
            *x *= inverse;
        }
    }
}

/// ln det (L Lᵀ). The pivots are multiplied as far as they neither overflow nor vanish: one logarithm instead of n.
#[inline(always)]
pub(crate) fn log_determinant(n: usize, l: &[f64]) -> f64 {
    let mut product = 1.0;
    let mut sum = 0.0;
    for i in 0..n {
        product *= l[i * n + i];
        if !(1e-100..1e100).contains(&product) {
            sum += libm::log(product);
            product = 1.0;
        }
    }
    2.0 * (sum + libm::log(product))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square<const N: usize>(n: usize, a: &[f64], b: &[f64], out: &mut [f64]) {
        let n = known::<N>(n);
        multiply::<N>(n, n, a, b, out);
    }

    fn numbers(count: usize) -> Vec<f64> {
        (0..count).map(|i| ((i * 7 + 3) % 11) as f64 - 4.7).collect()
    }

    #[test]
    fn a_constant_size_changes_no_bit() {
        for size in [2, 3, 4, 5, 6, 9, 11] {
            let (a, b) = (numbers(size * size), numbers(2 * size * size));
            let (mut constant, mut any) = (vec![0.0; size * size], vec![0.0; size * size]);
            sized!(square(size, &a, &b[size..], &mut constant));
            square::<0>(size, &a, &b[size..], &mut any);
            assert_eq!(constant, any);
            multiply_sparse::<0>(size, size, &a, &b[size..], &mut constant);
            assert_eq!(constant, any);
        }
    }

    #[test]
    fn a_factor_solves_its_matrix() {
        for n in [1, 2, 3, 4, 7, 9] {
            let b = numbers(n * n);
            let mut bt = b.clone();
            transpose(n, &b, &mut bt);
            let mut a = vec![0.0; n * n];
            multiply::<0>(n, n, &b, &bt, &mut a);
            (0..n).for_each(|i| a[i * n + i] += 1.0);
            let mut l = a.clone();
            cholesky(n, &mut l).unwrap();
            let mut x = numbers(n * 2);
            solve_lower::<2>(n, 2, &l, &mut x);
            solve_upper::<0>(n, 2, &l, &mut x);
            let mut back = vec![0.0; n * 2];
            multiply::<0>(n, 2, &a, &x, &mut back);
            for (found, expected) in back.iter().zip(numbers(n * 2)) {
                assert!((found - expected).abs() < 1e-10, "{n}");
            }
        }
    }

    #[test]
    fn the_logarithm_of_a_determinant_neither_overflows_nor_vanishes() {
        let diagonal: [f64; 4] = [1e-200, 1e-200, 1e250, 3.0];
        let mut l = vec![0.0; 16];
        (0..4).for_each(|i| l[5 * i] = diagonal[i]);
        let expected: f64 = diagonal.iter().map(|d| 2.0 * d.ln()).sum();
        assert!((log_determinant(4, &l) - expected).abs() < 1e-10);
    }

    #[test]
    fn a_bad_pivot_is_named() {
        let mut a = [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0];
        assert_eq!(cholesky(3, &mut a), Err(BadPivot { index: 1, value: -1.0 }));
        let mut a = [1.0, 0.0, f64::NAN, 1.0];
        assert!(cholesky(2, &mut a).is_err());
    }
}
