//! The window of [`super::noise`]: what is kept of each epoch, and the way back through them that smooths the states and
//! sums the estimates. Symbols and equations are those of that file; all memory serves one epoch after another.

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};

use super::link::{Link, LinkScratch, Step};
use super::noise::{Entry, LimitedMemoryNoise, NoiseEstimate, NoiseMethod, ProcessedEpoch};
use crate::error::Result;
use crate::gaussian::{Gaussian, GaussianRef};
use crate::linalg::kernel::{self, known, sized};
use crate::model::sensor::residual_into;
use crate::model::{Sensor, StateSpace};

/// What is kept of an epoch.
#[derive(Debug, Clone)]
pub(super) struct Remembered {
    link: Link,
    /// Z, rd×n; empty where no noise entered, so that the epoch says nothing about Q.
    projection: Vec<f64>,
    /// E, rd×rd.
    remainder: Vec<f64>,
    repeat: usize,
    measurement: Vec<f64>,
    platform: Option<DVector<f64>>,
}

impl Remembered {
    pub(super) fn new(space: StateSpace, m: usize) -> Self {
        Self {
            link: Link::new(space),
            projection: Vec::new(),
            remainder: Vec::new(),
            repeat: 1,
            measurement: vec![0.0; m],
            platform: None,
        }
    }

    /// Keeps the epoch after `before`, which was predicted with this Q.
    pub(super) fn set(
        &mut self,
        before: GaussianRef<'_>,
        epoch: &ProcessedEpoch<'_>,
        entry: &Entry,
        q: &DMatrix<f64>,
        number: usize,
        scratch: &mut LinkScratch,
    ) -> Result<()> {
        let n = before.dim();
        let step = Step {
            number,
            predicted: epoch.predicted,
            transition: epoch.transition,
            noise: epoch.noise,
        };
        let moves = self.link.set(before, &step, scratch)?;
        self.measurement.copy_from_slice(epoch.measurement);
        self.platform = epoch.platform.cloned();
        self.repeat = entry.repeat;
        self.projection.clear();
        self.remainder.clear();
        if moves && entry.enters {
            self.project(n, entry, q, scratch.lower());
        } else if entry.enters {
            // Nothing moved because Q is zero.
            let size = entry.gain.len() / n.max(1);
            self.projection.resize(size * n, 0.0);
            self.remainder.resize(size * size, 0.0);
        }
        Ok(())
    }

    /// With T = L⁻¹ Γ Q̄, n×rd: E = Q̄ − Tᵀ T, and Z = (L⁻ᵀ T)ᵀ.
    fn project(&mut self, n: usize, entry: &Entry, q: &DMatrix<f64>, lower: &[f64]) {
        let d = q.nrows();
        let size = entry.gain.len() / n.max(1);
        self.projection.resize(size * n, 0.0);
        self.remainder.resize(size * size, 0.0);
        // Each row of Q̄ Γᵀ is solved by itself.
        for (i, row) in self.projection.chunks_exact_mut(n.max(1)).enumerate() {
            let (block, a) = (i / d, i % d);
            for b in 0..d {
                let from = (block * d + b) * n;
                kernel::add_scaled(row, q[(a, b)], &entry.gain[from..from + n]);
            }
            kernel::solve_lower::<1>(n, 1, lower, row);
        }
        for i in 0..size {
            for j in 0..size {
                let own = if i / d == j / d { q[(i % d, j % d)] } else { 0.0 };
                let known = kernel::dot(
                    &self.projection[i * n..(i + 1) * n],
                    &self.projection[j * n..(j + 1) * n],
                );
                self.remainder[i * size + j] = own - known;
            }
        }
        for row in self.projection.chunks_exact_mut(n.max(1)) {
            kernel::solve_upper::<1>(n, 1, lower, row);
        }
    }
}

/// The sums over a window, lower halves row by row, which `finish` turns into means.
#[derive(Debug, Clone)]
pub(super) struct Sums {
    q: DMatrix<f64>,
    /// Epochs into which noise entered.
    pub(super) steps: f64,
    /// Over the epochs that used both components.
    r: DMatrix<f64>,
    uses: DMatrix<f64>,
    /// Over the epochs that used all components, and their number.
    r_complete: DMatrix<f64>,
    pub(super) complete: f64,
}

impl Sums {
    pub(super) fn new(d: usize, m: usize) -> Self {
        Self {
            q: DMatrix::zeros(d, d),
            steps: 0.0,
            r: DMatrix::zeros(m, m),
            uses: DMatrix::zeros(m, m),
            r_complete: DMatrix::zeros(m, m),
            complete: 0.0,
        }
    }

    pub(super) fn q(&self) -> &DMatrix<f64> {
        &self.q
    }

    pub(super) fn r(&self) -> &DMatrix<f64> {
        &self.r
    }

    pub(super) fn r_complete(&self) -> &DMatrix<f64> {
        &self.r_complete
    }

    /// Epochs that used component i.
    pub(super) fn uses(&self, i: usize) -> f64 {
        self.uses[(i, i)]
    }

    pub(super) fn estimate(&self) -> NoiseEstimate {
        NoiseEstimate {
            q: self.q.clone(),
            r: self.r.clone(),
        }
    }

    fn clear(&mut self) {
        for matrix in [&mut self.q, &mut self.r, &mut self.uses, &mut self.r_complete] {
            matrix.fill(0.0);
        }
        (self.steps, self.complete) = (0.0, 0.0);
    }

    /// Sums become means; a Q of which no epoch said anything stays what it is.
    pub(super) fn finish(&mut self, q: &DMatrix<f64>) {
        if self.steps == 0.0 {
            self.q.copy_from(q);
        } else {
            self.q /= self.steps;
            kernel::mirror(self.q.nrows(), self.q.as_mut_slice());
        }
        let m = self.r.nrows();
        for (sum, count) in self.r.iter_mut().zip(self.uses.iter()) {
            *sum /= count;
        }
        self.r_complete /= self.complete.max(1.0);
        kernel::mirror(m, self.r.as_mut_slice());
        kernel::mirror(m, self.r_complete.as_mut_slice());
    }
}

fn product<const N: usize>(n: usize, a: &[f64], b: &[f64], out: &mut [f64]) {
    let n = known::<N>(n);
    kernel::multiply::<N>(n, n, a, b, out);
}

fn sparse_product<const N: usize>(n: usize, a: &[f64], b: &[f64], out: &mut [f64]) {
    let n = known::<N>(n);
    kernel::multiply_sparse::<N>(n, n, a, b, out);
}

/// Where the way back works.
#[derive(Debug, Clone)]
pub(super) struct Walk {
    now: Gaussian,
    earlier: Gaussian,
    link: LinkScratch,
    offset: Vec<f64>,
    noise: Vec<f64>,
    spread: Vec<f64>,
    expected: Vec<f64>,
    predicted: Vec<f64>,
    jacobian: Vec<f64>,
    seen: Vec<f64>,
}

impl Walk {
    pub(super) fn new(n: usize) -> Self {
        let state = Gaussian {
            mean: DVector::zeros(n),
            cov: DMatrix::zeros(n, n),
        };
        Self {
            now: state.clone(),
            earlier: state,
            link: LinkScratch::new(n),
            offset: vec![0.0; n],
            noise: Vec::new(),
            spread: Vec::new(),
            expected: Vec::new(),
            predicted: Vec::new(),
            jacobian: Vec::new(),
            seen: Vec::new(),
        }
    }

    pub(super) fn link_scratch(&mut self) -> &mut LinkScratch {
        &mut self.link
    }

    /// Goes from the filtered estimate of the last epoch back through the window and sums.
    pub(super) fn back(
        &mut self,
        rule: &LimitedMemoryNoise,
        epochs: &VecDeque<Remembered>,
        last: GaussianRef<'_>,
        sensor: &dyn Sensor,
        sums: &mut Sums,
    ) -> Result<()> {
        sums.clear();
        self.now.mean.as_mut_slice().copy_from_slice(last.mean);
        self.now.cov.as_mut_slice().copy_from_slice(last.cov);
        for (age, epoch) in epochs.iter().rev().enumerate() {
            if age < rule.window && !epoch.projection.is_empty() {
                self.add_motion(epoch, rule.method, sums);
            }
            if age < rule.r_window() {
                self.add_measurement(epoch, rule.method, sensor, sums)?;
            }
            if age + 1 < epochs.len() {
                let (mean, cov) = (self.earlier.mean.as_mut_slice(), self.earlier.cov.as_mut_slice());
                epoch.link.back((&self.now).into(), &mut self.link, mean, cov);
                std::mem::swap(&mut self.now, &mut self.earlier);
            }
        }
        Ok(())
    }

    /// Adds the r diagonal blocks of u uᵀ (+ Z P Zᵀ + E), their mean counting as one step.
    fn add_motion(&mut self, epoch: &Remembered, method: NoiseMethod, sums: &mut Sums) {
        let (n, d) = (self.now.dim(), sums.q.nrows());
        let z = &epoch.projection[..];
        let size = z.len() / n;
        for ((o, x), predicted) in self
            .offset
            .iter_mut()
            .zip(self.now.mean.iter())
            .zip(epoch.link.predicted())
        {
            *o = x - predicted;
        }
        // The covariance is that of an error about x⁻ too.
        let counted = epoch
            .link
            .settle(self.now.mean.as_slice(), &mut self.offset)
            .map(|chart| {
                let mut cov = self.now.cov.clone();
                chart.both(n, cov.as_mut_slice());
                cov
            });
        self.noise.clear();
        self.noise
            .extend(z.chunks_exact(n).map(|row| kernel::dot(row, &self.offset)));
        let em = method == NoiseMethod::Em;
        if em {
            self.spread.resize(size * n, 0.0);
            let (cov, spread) = (counted.as_ref().unwrap_or(&self.now.cov).as_slice(), &mut self.spread);
            sized!(product(n, z, cov, spread));
        }
        let share = 1.0 / epoch.repeat as f64;
        let q = sums.q.as_mut_slice();
        for block in (0..size).step_by(d.max(1)) {
            for a in 0..d {
                for b in 0..=a {
                    let (i, j) = (block + a, block + b);
                    let mut sum = self.noise[i] * self.noise[j];
                    if em {
                        let (left, right) = (&self.spread[i * n..(i + 1) * n], &z[j * n..(j + 1) * n]);
                        sum += kernel::dot(left, right) + epoch.remainder[i * size + j];
                    }
                    q[a * d + b] += share * sum;
                }
            }
        }
        sums.steps += 1.0;
    }

    /// Adds e eᵀ (+ A P Aᵀ) of one epoch over its used components, and counts them.
    fn add_measurement(
        &mut self,
        epoch: &Remembered,
        method: NoiseMethod,
        sensor: &dyn Sensor,
        sums: &mut Sums,
    ) -> Result<()> {
        let (n, m) = (self.now.dim(), epoch.measurement.len());
        for buffer in [&mut self.jacobian, &mut self.seen] {
            buffer.resize(m * n, 0.0);
        }
        self.expected.resize(m, 0.0);
        let e = &mut self.expected;
        sensor.linearise_into(&self.now.mean, epoch.platform.as_ref(), e, &mut self.jacobian)?;
        self.predicted.clone_from(e);
        residual_into(sensor, &epoch.measurement, &self.predicted, e);
        let em = method == NoiseMethod::Em;
        if em {
            let (a, cov, seen) = (&self.jacobian, self.now.cov.as_slice(), &mut self.seen);
            sized!(sparse_product(n, a, cov, seen));
        }
        let all = e.iter().all(|e| !e.is_nan());
        sums.complete += if all { 1.0 } else { 0.0 };
        let (r, uses, complete) = (
            sums.r.as_mut_slice(),
            sums.uses.as_mut_slice(),
            sums.r_complete.as_mut_slice(),
        );
        for i in (0..m).filter(|&i| !e[i].is_nan()) {
            let row = &self.jacobian[i * n..(i + 1) * n];
            for j in (0..=i).filter(|&j| !e[j].is_nan()) {
                let mut sum = e[i] * e[j];
                if em {
                    sum += kernel::dot(row, &self.seen[j * n..(j + 1) * n]);
                }
                r[i * m + j] += sum;
                uses[i * m + j] += 1.0;
                if all {
                    complete[i * m + j] += sum;
                }
            }
        }
        Ok(())
    }
}
