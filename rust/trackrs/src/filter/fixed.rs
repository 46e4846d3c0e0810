//! Rows of a run with sizes known to the compiler: the same operations in the same order as those of [`super::runner`], on
//! arrays of constant size, so that loops unroll and nothing is allocated.
//!
//! | symbol  | name here            | shape    | meaning                                              |
//! |---------|----------------------|----------|------------------------------------------------------|
//! | x, P    | `x`, `p`             | N, N×N   | the state, after the measurement of the row before   |
//! | x⁻, P⁻  | `ahead`              | N, N×N   | before that of this row                              |
//! | F, Q    | [`Way`]              | N×N      | of the motion over dt; made when dt changes          |
//! | H, R    | `h`, `r`             | M×N, M×M | of the sensor                                        |
//! | S, L    | `s`, `l`             | M×M      | innovation covariance and its Cholesky factor        |
//! | Kᵀ      | `gain`               | M×N      | gain                                                 |
//!
//! 1. x⁻ = F x,  P⁻ = F P Fᵀ + Q                          (`prediction.rs`)
//! 2. r = z − h(x⁻),  S = H P⁻ Hᵀ + R = L Lᵀ              (`kalman.rs`, `extended.rs`)
//! 3. ν = L⁻¹ r,  |ν|²,  ln N(r; 0, S)
//! 4. x = x⁻ + K r,  B = P⁻ − K H P⁻,  P = B + (K R − B Hᵀ) Kᵀ, made symmetric   (`correction.rs`)
//!
//! All but x, r and ν is the same for every row that begins with the same P, where F, Q and H stay what they are: it is made
//! once. With a constant dt P often becomes steady to the last bit, after some tens of rows.
//!
//! A run has it where its filter is plain ([`fixed`]): a linear motion, any sensor, no screen, no estimated noise, the Joseph
//! form, everything adds. Of its rows those with a missing or infinite component, those whose S has no factor and those with a
//! nearly singular P⁻ or P are left to the general path, which knows what to do with them; the bits are the same either way (`tests/fixed.rs`).
//!
//! Whether they are is mostly told by a bound of |P| from below: |P⁻| ≥ |P| + |Q| where |F| = 1 (Minkowski), |P| = |P⁻| |R|/|S|
//! after the measurement, and the least part that is left of a component's variance once others are known is at least |P|/Π P_ii.
//! Only where the bound does not keep that above [`SURE`] is P⁻ factored, and the bound begins again at what it is.
//!
//! Reference: see [`super::kalman`].

use std::array;
use std::ops::Range;

use nalgebra::DVector;

use super::extended::{Method, Rule};
use super::kalman::LN_TAU;
use super::run::{Estimates, FilterRun};
use super::sequence::{Filter, History, Sequence};
use super::square_root::Form;
use crate::error::Result;
use crate::gaussian::{Gaussian, GaussianRef};
use crate::interrupt::ahead;
use crate::linalg::copy_rows;
use crate::linalg::fixed::{
    Factor, Lines, add_scaled, determinant_unless_little_left, mirror, same_bits, symmetrise, transpose,
};
use crate::linalg::kernel::NEARLY_SINGULAR;
use crate::linalg::sparse::UnitUpper;
use crate::model::sensor::residual_into;
use crate::model::{Motion, MotionModel, Sensor, SensorModel};

/// So far from singular that rounding does not count.
const SURE: f64 = 1e-11;

/// As so much of what it is |Q| counts, for rounding.
const NOISE_COUNTS: f64 = 0.99;

/// Rows of a filter of one size.
pub(super) trait FixedRows: Send + Sync {
    /// Takes the state through the first of these rows, up to one that is not for it; the number of rows that it took.
    fn advance(
        &mut self,
        filter: &Filter,
        now: Now<'_>,
        data: &Sequence<'_>,
        rows: Range<usize>,
        history: History,
        run: &mut FilterRun,
    ) -> Result<usize>;
}

/// Where a run stands.
pub(super) struct Now<'a> {
    pub(super) time: &'a mut f64,
    pub(super) state: &'a mut Gaussian,
}

/// The rows of this filter, if it is plain and of a size that is compiled.
pub(super) fn fixed(filter: &Filter) -> Option<Box<dyn FixedRows>> {
    macro_rules! of_sizes {
        ($($n:literal: $($m:literal)*;)*) => {
            match (filter.motion().state_dim(), filter.sensor().measurement_dim()) {
                $($(($n, $m) => Some(Box::new(Fixed::<$n, $m>::new(filter))),)*)*
                _ => None,
            }
        };
    }
    if !plain(filter) {
        return None;
    }
    of_sizes! {
        2: 1 2;
        3: 1 2 3;
        4: 1 2 3;
        6: 2 3 4;
        9: 3 4;
        18: 6;
    }
}

fn plain(filter: &Filter) -> bool {
    let Method { rule, form } = *filter.method();
    let (motion, sensor) = (filter.motion(), filter.sensor());
    let by_slope = match rule {
        Rule::Once => true,
        Rule::Iterated(iterations) => iterations == 1 || sensor.is_linear(),
        Rule::SecondOrder => false,
        Rule::SigmaPoints(points) => points.redraws() && sensor.is_linear_in_changes(),
    };
    by_slope
        && form == Form::Joseph
        && motion.is_linear()
        && motion.space().attitude.is_none()
        && filter.steps() == 1
        && filter.screen().is_none()
        && !filter.adapts()
}

struct Fixed<const N: usize, const M: usize> {
    way: Way<N>,
    h: [[f64; N]; M],
    /// H again, without its zeros, and whether it stays what it is.
    lines: Lines<M, N>,
    constant: bool,
    /// Whether covariances are looked at.
    watch: bool,
    /// det R; 0 where it has no factor.
    determinant: f64,
    /// R without its zeros, and (R + Rᵀ)/2.
    noise: Lines<M, M>,
    symmetric: [[f64; M]; M],
    /// Of the last row, where another one with the same covariance before it would give the same.
    last: Option<Covariances<N, M>>,
    /// The mean for the sensor, which takes it in this form.
    mean: DVector<f64>,
}

/// The way from one row to the next.
struct Way<const N: usize> {
    /// Seconds; NaN: none yet.
    dt: f64,
    f: [[f64; N]; N],
    q: [[f64; N]; N],
    lines: Lines<N, N>,
    upper: Option<UnitUpper>,
    /// |Q| is at least this.
    spread: f64,
}

/// What a row does whatever was measured.
struct Covariances<const N: usize, const M: usize> {
    before: [[f64; N]; N],
    ahead: [[f64; N]; N],
    s: [[f64; M]; M],
    factor: Factor<M>,
    log_determinant: f64,
    gain: [[f64; N]; M],
    after: [[f64; N]; N],
    /// |P| is at least this; 0 where nothing is known.
    least: f64,
}

impl<const N: usize, const M: usize> FixedRows for Fixed<N, M> {
    fn advance(
        &mut self,
        filter: &Filter,
        now: Now<'_>,
        data: &Sequence<'_>,
        rows: Range<usize>,
        history: History,
        run: &mut FilterRun,
    ) -> Result<usize> {
        let (mut x, mut p) = ([0.0; N], [[0.0; N]; N]);
        x.copy_from_slice(now.state.mean.as_slice());
        p.as_flattened_mut().copy_from_slice(now.state.cov.as_slice());
        let (mut taken, mut failed, mut least) = (0, None, 0.0);
        let times = &data.times[rows.clone()];
        let measurements = data.measurements[rows.start * M..rows.end * M].as_chunks::<M>().0;
        for (&time, z) in times.iter().zip(measurements) {
            ahead(N * N);
            if !z.iter().all(|z| z.is_finite()) {
                break;
            }
            let dt = time - *now.time;
            if self.way.dt.is_nan() || !filter.motion().same_over(dt, self.way.dt) {
                self.way.make(filter.motion(), dt);
                self.last = None;
            }
            let ahead: [f64; N] = array::from_fn(|i| self.way.lines.row_dot(i, &x));
            let r = match self.compare(filter.sensor(), &ahead, z) {
                Ok(r) => r,
                Err(error) => {
                    failed = Some(error);
                    break;
                }
            };
            if !self.last.as_ref().is_some_and(|last| same_bits(&last.before, &p)) {
                let mut covs = self.way.covariances(&p, &self.lines, &self.noise, &self.symmetric);
                let least_ahead = self.way.least(least);
                covs.take_if(|covs| self.watch && covs.nearly_singular(self.determinant, least_ahead));
                self.last = covs;
            }
            let Some(covs) = &self.last else {
                break;
            };
            let mut whitened = r.map(|r| [r]);
            covs.factor.solve_lower(&mut whitened);
            let nis = whitened.iter().fold(0.0, |sum, [x]| sum + x * x);
            run.log_likelihood += -0.5 * (nis + covs.log_determinant + M as f64 * LN_TAU);
            x = ahead;
            for (row, &r) in covs.gain.iter().zip(&r) {
                add_scaled(&mut x, r, row);
            }
            (p, least) = (covs.after, covs.least);
            *now.time = time;
            taken += 1;
            if history == History::Last && taken < times.len() {
                continue;
            }
            let row = Estimates {
                predicted: GaussianRef {
                    mean: &ahead,
                    cov: covs.ahead.as_flattened(),
                },
                transition: self.way.f.as_flattened(),
                motion_noise: self.way.q.as_flattened(),
                filtered: GaussianRef {
                    mean: &x,
                    cov: covs.after.as_flattened(),
                },
                innovation: &r,
                innovation_cov: covs.s.as_flattened(),
                nis,
                dof: M,
            };
            run.push_estimates(&row, history);
        }
        now.state.mean.copy_from_slice(&x);
        now.state.cov.as_mut_slice().copy_from_slice(p.as_flattened());
        failed.map_or(Ok(taken), Err)
    }
}

impl<const N: usize, const M: usize> Fixed<N, M> {
    fn new(filter: &Filter) -> Self {
        let mut r = [[0.0; M]; M];
        copy_rows(&filter.sensor().noise(), r.as_flattened_mut());
        let mut noise = Lines::new();
        noise.set(&r);
        let symmetric = array::from_fn(|a| array::from_fn(|b| 0.5 * (r[a][b] + r[b][a])));
        Self {
            way: Way {
                dt: f64::NAN,
                f: [[0.0; N]; N],
                q: [[0.0; N]; N],
                lines: Lines::new(),
                upper: None,
                spread: 0.0,
            },
            h: [[0.0; N]; M],
            lines: Lines::new(),
            constant: false,
            watch: filter.escalates(),
            determinant: Factor::new(&symmetric).map_or(0.0, |factor| factor.determinant()),
            noise,
            symmetric,
            last: None,
            mean: DVector::zeros(N),
        }
    }

    /// z − h(x⁻), with H set.
    #[inline(always)]
    fn compare(&mut self, sensor: &SensorModel, ahead: &[f64; N], z: &[f64; M]) -> Result<[f64; M]> {
        self.mean.as_mut_slice().copy_from_slice(ahead);
        let (mut expected, mut r) = ([0.0; M], [0.0; M]);
        sensor.linearise_into(&self.mean, None, &mut expected, self.h.as_flattened_mut())?;
        if !self.constant {
            self.lines.set(&self.h);
            self.constant = sensor.is_linear();
            self.last = None;
        }
        residual_into(sensor, z, &expected, &mut r);
        Ok(r)
    }
}

impl<const N: usize, const M: usize> Covariances<N, M> {
    /// Whether P⁻, of which |P⁻| is at least this, or P is. P is at least |R|/|S| of P⁻ (in the order of matrices): one look
    /// at P⁻ is mostly enough.
    #[inline(always)]
    fn nearly_singular(&mut self, noise: f64, least_ahead: f64) -> bool {
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
    /// Makes it the way of `dt` seconds.
    #[inline(never)]
    fn make(&mut self, motion: &MotionModel, dt: f64) {
        motion.noise_into(dt, self.q.as_flattened_mut());
        motion.transition_into(dt, self.f.as_flattened_mut());
        self.lines.set(&self.f);
        UnitUpper::renew(&mut self.upper, N, self.f.as_flattened());
        self.spread = NOISE_COUNTS * determinant_unless_little_left(SURE, &self.q).unwrap_or(0.0);
        self.dt = dt;
    }

    /// What |P⁻| is at least, if |P| is at least this.
    #[inline(always)]
    fn least(&self, before: f64) -> f64 {
        if self.upper.is_some() {
            before + self.spread
        } else {
            0.0
        }
    }

    /// Equations 1, 2 and 4 as far as they do not depend on what is measured.
    #[inline(always)]
    fn covariances<const M: usize>(
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
