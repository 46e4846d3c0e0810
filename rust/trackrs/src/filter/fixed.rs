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
//! Only where the bound does not keep that far from zero is P⁻ factored, and the bound begins again at what it is.
//!
//! Reference: see [`super::kalman`].

mod covariances;

use std::array;
use std::ops::Range;

use nalgebra::DVector;

use self::covariances::{Covariances, Way};
use super::extended::{Method, Rule};
use super::kalman::LN_TAU;
use super::run::{Estimates, FilterRun};
use super::sequence::{Filter, History, Sequence};
use super::square_root::Form;
use crate::error::Result;
use crate::gaussian::{Gaussian, GaussianRef};
use crate::interrupt::ahead;
use crate::linalg::copy_rows;
use crate::linalg::fixed::{Factor, Lines, add_scaled, same_bits};
use crate::model::sensor::residual_into;
use crate::model::{Motion, Sensor, SensorModel};

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
        // Whether P is that of the row before.
        let mut goes_on = false;
        let times = &data.times[rows.clone()];
        let measurements = data.measurements[rows.start * M..rows.end * M].as_chunks::<M>().0;
        for (&time, z) in times.iter().zip(measurements) {
            ahead(N * N);
            if !z.iter().all(|z| z.is_finite()) {
                break;
            }
            let dt = time - *now.time;
            if dt.to_bits() != self.way.dt.to_bits()
                && (self.way.dt.is_nan() || !filter.motion().same_over(dt, self.way.dt))
            {
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
            let again = |last: &Covariances<N, M>| goes_on && last.steady || same_bits(&last.before, &p);
            if !self.last.as_ref().is_some_and(again) {
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
            if !(goes_on && covs.steady) {
                (p, least) = (covs.after, covs.least);
            }
            goes_on = true;
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
            way: Way::new(),
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
        match sensor {
            SensorModel::Position(_) if self.constant => Ok(array::from_fn(|a| z[a] - ahead[a])),
            SensorModel::Linear(sensor) if self.constant => {
                let offset = sensor.offset().as_slice();
                Ok(array::from_fn(|a| {
                    let products = self.h[a].iter().zip(ahead);
                    z[a] - (products.fold(0.0, |sum, (h, x)| sum + h * x) + offset[a])
                }))
            }
            _ => self.compare_anew(sensor, ahead, z),
        }
    }

    /// The same where the sensor is to be asked.
    #[inline(never)]
    fn compare_anew(&mut self, sensor: &SensorModel, ahead: &[f64; N], z: &[f64; M]) -> Result<[f64; M]> {
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
