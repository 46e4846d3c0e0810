//! What a row does to covariances, whatever was measured: equations 1, 2 and 4 of [`super`], and the look at how nearly singular
//! they are.

use crate::linalg::fixed::{
    Factor, Lines, add_scaled, determinant_unless_little_left, mirror, same_bits, symmetrise, transpose,
};
use crate::linalg::kernel::NEARLY_SINGULAR;
use crate::linalg::sparse::UnitUpper;
use crate::model::{Motion, MotionModel};

/// So far from singular that rounding does not count.
const SURE: f64 = 1e-11;

/// As so much of what it is |Q| counts, for rounding.
const NOISE_COUNTS: f64 = 0.99;

/// The way from one row to the next.
pub(super) struct Way<const N: usize> {
    /// Seconds; NaN: none yet.
    pub(super) dt: f64,
    pub(super) f: [[f64; N]; N],
    pub(super) q: [[f64; N]; N],
    pub(super) lines: Lines<N, N>,
    upper: Option<UnitUpper>,
    /// |Q| is at least this.
    spread: f64,
}

/// What a row does whatever was measured.
pub(super) struct Covariances<const N: usize, const M: usize> {
    pub(super) before: [[f64; N]; N],
    pub(super) ahead: [[f64; N]; N],
    pub(super) s: [[f64; M]; M],
    pub(super) factor: Factor<M>,
    pub(super) log_determinant: f64,
    pub(super) gain: [[f64; N]; M],
    pub(super) after: [[f64; N]; N],
    /// Whether P is what it was before the row.
    pub(super) steady: bool,
    /// |P| is at least this; 0 where nothing is known.
    pub(super) least: f64,
}

impl<const N: usize, const M: usize> Covariances<N, M> {
    /// Whether P⁻, of which |P⁻| is at least this, or P is. P is at least |R|/|S| of P⁻ (in the order of matrices): one look
    /// at P⁻ is mostly enough.
    #[inline(always)]
    pub(super) fn nearly_singular(&mut self, noise: f64, least_ahead: f64) -> bool {
        let shrunk = noise / self.factor.determinant();
        let variances = (0..N).fold(1.0, |product, i| product * self.ahead[i][i]);
        self.least = shrunk * least_ahead;
        if self.least > SURE * variances {
            return false;
        }
        self.is_nearly_singular(shrunk)
    }

    /// The same by factors.
    #[inline(never)]
    fn is_nearly_singular(&mut self, shrunk: f64) -> bool {
        self.least = 0.0;
        let part = SURE / shrunk;
        // Not where that is no number.
        if part < 1.0
            && let Some(determinant) = determinant_unless_little_left(part, &self.ahead)
        {
            self.least = shrunk * determinant;
            return false;
        }
        let definite = |cov| determinant_unless_little_left(NEARLY_SINGULAR, cov).is_some();
        !(definite(&self.ahead) && definite(&self.after))
    }
}

impl<const N: usize> Way<N> {
    /// None yet.
    pub(super) fn new() -> Self {
        Self {
            dt: f64::NAN,
            f: [[0.0; N]; N],
            q: [[0.0; N]; N],
            lines: Lines::new(),
            upper: None,
            spread: 0.0,
        }
    }

    /// Makes it the way of `dt` seconds.
    #[inline(never)]
    pub(super) fn make(&mut self, motion: &MotionModel, dt: f64) {
        motion.noise_into(dt, self.q.as_flattened_mut());
        motion.transition_into(dt, self.f.as_flattened_mut());
        self.lines.set(&self.f);
        UnitUpper::renew(&mut self.upper, N, self.f.as_flattened());
        self.spread = NOISE_COUNTS * determinant_unless_little_left(SURE, &self.q).unwrap_or(0.0);
        self.dt = dt;
    }

    /// What |P⁻| is at least, if |P| is at least this.
    #[inline(always)]
    pub(super) fn least(&self, before: f64) -> f64 {
        if self.upper.is_some() {
            before + self.spread
        } else {
            0.0
        }
    }

    /// Equations 1, 2 and 4 as far as they do not depend on what is measured.
    #[inline(always)]
    pub(super) fn covariances<const M: usize>(
        &self,
        before: &[[f64; N]; N],
        h: &Lines<M, N>,
        r: &Lines<M, M>,
        symmetric: &[[f64; M]; M],
    ) -> Option<Covariances<N, M>> {
        let mut ahead = *before;
        if let Some(upper) = &self.upper {
            upper.congruence_in_place(&mut ahead, &self.q);
        } else {
            let product = transpose(&self.lines.times(before));
            ahead = self.lines.times_plus(&product, &self.q);
            mirror(&mut ahead);
        }
        let hp = h.times(&ahead);
        let mut s = [[0.0; M]; M];
        for a in 0..M {
            for b in 0..M {
                if b <= a {
                    let sum = h.row_dot(b, &hp[a]) + symmetric[a][b];
                    (s[a][b], s[b][a]) = (sum, sum);
                }
            }
        }
        let factor = Factor::new(&s)?;
        let mut gain = hp;
        factor.solve_lower(&mut gain);
        factor.solve_upper(&mut gain);
        let mut after = ahead;
        for (i, row) in after.iter_mut().enumerate() {
            for (hp, gain) in hp.iter().zip(&gain) {
                add_scaled(row, -hp[i], gain);
            }
        }
        let (seen, mut rest) = (h.times(&after), r.times(&gain));
        for (x, y) in rest.as_flattened_mut().iter_mut().zip(seen.as_flattened()) {
            *x -= y;
        }
        for (i, row) in after.iter_mut().enumerate() {
            for (gain, rest) in gain.iter().zip(&rest) {
                add_scaled(row, gain[i], rest);
            }
        }
        symmetrise(&mut after);
        Some(Covariances {
            steady: same_bits(before, &after),
            before: *before,
            ahead,
            s,
            log_determinant: factor.log_determinant(),
            factor,
            gain,
            after,
            least: 0.0,
        })
    }
}
