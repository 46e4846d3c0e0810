//! The prediction step, in memory that serves one epoch after another.
//!
//! | symbol | name here    | shape  | meaning                                     |
//! |--------|--------------|--------|---------------------------------------------|
//! | x, P   | `prior`      | n, n×n | the estimate to begin with                  |
//! | F, Q   | `transition`, `noise` | n×n | of the motion over dt, or of a rule that stands in for it |
//! | u      | `input`      | n      | known input                                 |
//!
//! x⁻ = f(x) + u,  P⁻ = F P Fᵀ + Q, the lower half computed and mirrored. F and Q of a linear motion are made anew only
//! when dt changes, and their zeros are passed over; where F has ones on its diagonal and nothing below, as kinematic motions
//! have it, P⁻ is made in place.
//! With sigma points x⁻ is the mean of f, F the line that fits best and Q larger by the bends ([`super::sigma_points`]); for
//! a linear motion these are f, F and Q themselves, and no points are drawn unless a measurement is to use them.
//! In square-root form the factor of P⁻ comes from those of P and Q ([`super::square_root`]) and P⁻ from it.
//! Reference: Bar-Shalom, Li, Kirubarajan (2001), §5.2.

use nalgebra::{DMatrix, DVector};

use super::chart::Chart;
use super::extended::Rule;
use super::sigma_points::{SigmaPoints, Spread};
use super::square_root::{Form, Reflector, lower_root, square};
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::linalg::copy_rows;
use crate::linalg::kernel::{self, known, sized};
use crate::linalg::sparse::{Sparse, UnitUpper};
use crate::model::{Motion, StateSpace};

/// What a state is predicted by.
#[derive(Clone, Copy)]
pub struct Course<'a> {
    /// f and Q.
    pub motion: &'a dyn Motion,
    /// Seconds.
    pub dt: f64,
    /// Added to the predicted state, length n.
    pub input: Option<&'a [f64]>,
    /// Q, n×n, instead of the motion's own.
    pub noise: Option<&'a [f64]>,
}

/// A prediction and the matrices that made it, which a smoother needs again. Its memory serves one epoch after another.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// The estimate before the measurement.
    pub state: Gaussian,
    space: StateSpace,
    rule: Rule,
    transition: Vec<f64>,
    /// Q, and Q with the bends where there are any.
    noise: Vec<f64>,
    bent: Option<Vec<f64>>,
    /// F again, and once more where it is of that kind.
    sparse: Sparse,
    upper: Option<UnitUpper>,
    /// A row of F P, and (F P)ᵀ.
    product: Vec<f64>,
    transposed: Vec<f64>,
    /// The step that F is of, and that for which Q is the model's own; NaN: none.
    transition_dt: f64,
    noise_dt: f64,
    /// The points of the last prediction, where it had any.
    spread: Option<Spread>,
    root: Option<Root>,
}

/// What the square-root form needs besides.
#[derive(Debug, Clone)]
struct Root {
    /// Of the prediction: P⁻ = Uᵀ U.
    factor: Vec<f64>,
    noise: Vec<f64>,
    /// The step for which the factor of Q is the model's own; NaN: none.
    noise_dt: f64,
    rows: Vec<f64>,
    reflector: Reflector,
}

impl Prediction {
    /// Memory for states of this space.
    pub fn new(space: StateSpace, rule: Rule, form: Form) -> Self {
        let n = space.dim;
        let square = || vec![0.0; n * n];
        Self {
            state: Gaussian {
                mean: DVector::zeros(n),
                cov: DMatrix::zeros(n, n),
            },
            space,
            rule,
            transition: square(),
            noise: square(),
            bent: None,
            sparse: Sparse::default(),
            upper: None,
            product: square(),
            transposed: square(),
            transition_dt: f64::NAN,
            noise_dt: f64::NAN,
            spread: None,
            root: (form == Form::SquareRoot).then(|| Root {
                factor: square(),
                noise: square(),
                noise_dt: f64::NAN,
                rows: Vec::with_capacity((3 * n + 1) * n),
                reflector: Reflector::default(),
            }),
        }
    }

    /// Memory for the same in another form.
    pub(super) fn in_form(&self, form: Form) -> Self {
        Self::new(self.space, self.rule, form)
    }

    /// F, n×n, row by row.
    pub fn transition(&self) -> &[f64] {
        &self.transition
    }

    /// Q, n×n, row by row.
    pub fn noise(&self) -> &[f64] {
        self.bent.as_ref().unwrap_or(&self.noise)
    }

    /// The factor of the covariance, n×n, in square-root form.
    pub(super) fn factor(&self) -> Option<&[f64]> {
        self.root.as_ref().map(|root| &root.factor[..])
    }

    /// The points that were predicted, for a rule that carries them on to the measurement.
    pub(super) fn carried(&self) -> Option<&Spread> {
        self.spread.as_ref()
    }

    /// Predicts `prior`, whose factor is `factor` in square-root form.
    pub fn predict(&mut self, prior: &Gaussian, factor: Option<&[f64]>, course: &Course<'_>) -> Result<()> {
        if let Some(noise) = course.noise {
            self.noise.copy_from_slice(noise);
            self.noise_dt = f64::NAN;
        } else if self.space.attitude.is_some() {
            copy_rows(&course.motion.noise_at(&prior.mean, course.dt), &mut self.noise);
            self.noise_dt = f64::NAN;
        } else if course.dt != self.noise_dt {
            course.motion.noise_into(course.dt, &mut self.noise);
            self.noise_dt = course.dt;
        }
        self.set_noise_root()?;
        self.bent = None;
        let linear = course.motion.is_linear();
        match self.rule {
            Rule::SigmaPoints(points) if !linear || !points.redraws() => {
                self.spread_out(&points, prior, factor, course)?;
            }
            _ => self.linearise(prior, factor, course)?,
        }
        if let Some(input) = course.input {
            kernel::add_scaled(self.state.mean.as_mut_slice(), 1.0, input);
            let chart = Chart::of_input(self.space, input, self.state.mean.as_mut_slice());
            if let (Rule::SigmaPoints(points), Some(spread)) = (self.rule, &mut self.spread)
                && !points.redraws()
            {
                for image in spread.images.chunks_exact_mut(input.len().max(1)) {
                    kernel::add_scaled(image, 1.0, input);
                    let _ = Chart::of_input(self.space, input, image);
                }
            }
            if let Some(chart) = chart {
                self.turn(&chart);
            }
        }
        Ok(())
    }

    /// Counts the error of the prediction from another point.
    fn turn(&mut self, chart: &Chart) {
        let n = self.space.dim;
        chart.rows(n, &mut self.transition);
        chart.both(n, &mut self.noise);
        chart.both(n, self.state.cov.as_mut_slice());
        if let Some(bent) = &mut self.bent {
            chart.both(n, bent);
        }
        if let Some(root) = &mut self.root {
            chart.columns(n, &mut root.factor);
        }
        if let Some(spread) = &mut self.spread {
            chart.columns(n, &mut spread.slopes);
            chart.columns(n, &mut spread.bends);
        }
    }

    fn linearise(&mut self, prior: &Gaussian, factor: Option<&[f64]>, course: &Course<'_>) -> Result<()> {
        let (n, dt) = (prior.dim(), course.dt);
        let mean = self.state.mean.as_mut_slice();
        if course.motion.is_linear() {
            if dt != self.transition_dt {
                course.motion.transition_into(dt, &mut self.transition);
                self.sparse.set(n, &self.transition);
                UnitUpper::renew(&mut self.upper, n, &self.transition);
                self.transition_dt = dt;
            }
            for (i, x) in mean.iter_mut().enumerate() {
                *x = self.sparse.row_dot(i, prior.mean.as_slice());
            }
        } else {
            course
                .motion
                .linearise_into(&prior.mean, dt, mean, &mut self.transition)?;
            self.sparse.set(n, &self.transition);
            self.upper = None;
            self.transition_dt = f64::NAN;
        }
        let cov = self.state.cov.as_mut_slice();
        if let (Some(root), Some(factor)) = (&mut self.root, factor) {
            root.rows.clear();
            // Row k of U Fᵀ is F times row k of U.
            for row in factor.chunks_exact(n.max(1)) {
                match &self.upper {
                    Some(upper) => upper.extend_product(row, &mut root.rows),
                    None => root.rows.extend((0..n).map(|i| self.sparse.row_dot(i, row))),
                }
            }
            root.finish(n, cov);
            return Ok(());
        }
        let prior = prior.cov.as_slice();
        if let Some(upper) = &self.upper {
            sized!(predict_in_place(n, upper, &self.noise, prior, cov));
        } else {
            let work = [&mut self.product[..n], &mut self.transposed[..]];
            sized!(predict_cov(n, &self.sparse, &self.noise, prior, work, cov));
        }
        Ok(())
    }

    fn spread_out(
        &mut self,
        points: &SigmaPoints,
        prior: &Gaussian,
        factor: Option<&[f64]>,
        course: &Course<'_>,
    ) -> Result<()> {
        let n = prior.dim();
        let spread = self.spread.get_or_insert_with(|| Spread::new(self.space, self.space));
        draw(spread, points, prior, factor)?;
        course
            .motion
            .propagate_all(&spread.points, course.dt, &mut spread.images)?;
        // The images are needed again where the measurement is of the same points.
        let images = (!points.redraws()).then(|| spread.images.clone());
        spread.summarise(points, &[]);
        spread.slope_into(&mut self.product, &mut self.transition);
        self.transition_dt = f64::NAN;
        self.state.mean.as_mut_slice().copy_from_slice(&spread.mean);
        let bent = self.bent.insert(self.noise.clone());
        spread.add_bends(bent);
        kernel::mirror(n, bent);
        let cov = self.state.cov.as_mut_slice();
        if let Some(root) = &mut self.root {
            root.rows.clear();
            root.rows.extend_from_slice(&spread.slopes);
            root.rows.extend_from_slice(&spread.bends);
            root.finish(n, cov);
        } else {
            cov.copy_from_slice(bent);
            kernel::transpose(n, &spread.slopes, &mut self.transposed);
            kernel::add_product_lower(n, n, &self.transposed, &spread.slopes, cov);
            kernel::mirror(n, cov);
        }
        if let Some(images) = images {
            spread.images = images;
        }
        Ok(())
    }

    fn set_noise_root(&mut self) -> Result<()> {
        let n = self.state.dim();
        let Some(root) = &mut self.root else {
            return Ok(());
        };
        // NaN differs from itself: noise that is not the model's own is always factored anew.
        if root.noise_dt != self.noise_dt {
            lower_root(n, &self.noise, &mut self.product, &mut root.noise, "motion noise")?;
            root.noise_dt = self.noise_dt;
        }
        Ok(())
    }

    /// Makes this the prediction of a state that was reached from nothing: F = 0, Q = P.
    pub fn cut(&mut self, start: &Gaussian) {
        self.state.clone_from(start);
        self.transition.fill(0.0);
        self.noise.copy_from_slice(start.cov.as_slice());
        self.bent = None;
        (self.transition_dt, self.noise_dt) = (f64::NAN, f64::NAN);
    }

    /// Makes F and Q those of the way from before `earlier`, a prediction that this one follows.
    pub(super) fn join(&mut self, earlier: &Steps) {
        let n = self.state.dim();
        let mut transition = vec![0.0; n * n];
        kernel::multiply::<0>(n, n, &self.transition, &earlier.transition, &mut transition);
        let mut noise = self.noise().to_vec();
        kernel::multiply::<0>(n, n, &self.transition, &earlier.noise, &mut self.product);
        kernel::transpose(n, &self.transition, &mut self.transposed);
        kernel::add_product_lower(n, n, &self.product, &self.transposed, &mut noise);
        kernel::mirror(n, &mut noise);
        self.transition = transition;
        self.transition_dt = f64::NAN;
        self.bent = Some(noise);
    }
}

/// F and Q of the steps taken so far.
#[derive(Debug, Clone)]
pub(super) struct Steps {
    transition: Vec<f64>,
    noise: Vec<f64>,
}

impl From<&Prediction> for Steps {
    fn from(prediction: &Prediction) -> Self {
        Self {
            transition: prediction.transition.clone(),
            noise: prediction.noise().to_vec(),
        }
    }
}

impl Root {
    /// The factor and the covariance of the rows gathered and the noise.
    fn finish(&mut self, n: usize, cov: &mut [f64]) {
        self.rows.extend_from_slice(&self.noise);
        self.reflector.triangularise(n, &mut self.rows);
        self.factor.copy_from_slice(&self.rows[..n * n]);
        square(n, &self.factor, cov);
    }
}

/// Draws the points of a state from its covariance or, in square-root form, its factor.
pub(super) fn draw(spread: &mut Spread, rule: &SigmaPoints, prior: &Gaussian, factor: Option<&[f64]>) -> Result<()> {
    let (n, mean) = (prior.dim(), prior.mean.as_slice());
    let Some(factor) = factor else {
        return spread.draw(rule, mean, prior.cov.as_slice(), "covariance of the sigma points");
    };
    // L of P = L Lᵀ: the factor made triangular with its columns in reverse, and transposed.
    let mut rows: Vec<f64> = factor
        .chunks_exact(n.max(1))
        .flat_map(|row| row.iter().rev().copied())
        .collect();
    Reflector::default().triangularise(n, &mut rows);
    let mut lower = vec![0.0; n * n];
    for k in 0..n {
        let row = &rows[(n - 1 - k) * n..(n - k) * n];
        let sign = if row[n - 1 - k] < 0.0 { -1.0 } else { 1.0 };
        for i in k..n {
            lower[i * n + k] = sign * row[n - 1 - i];
        }
    }
    spread.draw_from(rule, mean, &lower);
    Ok(())
}

fn predict_in_place<const N: usize>(n: usize, f: &UnitUpper, noise: &[f64], cov: &[f64], out: &mut [f64]) {
    f.congruence::<N>(known::<N>(n), cov, noise, out);
}

/// P⁻ = F P Fᵀ + Q as F (F P)ᵀ + Q, the lower half computed and mirrored.
fn predict_cov<const N: usize>(
    n: usize,
    f: &Sparse,
    noise: &[f64],
    cov: &[f64],
    work: [&mut [f64]; 2],
    out: &mut [f64],
) {
    let n = known::<N>(n);
    let [row, transposed] = work;
    f.multiply_transposed::<N>(n, cov, row, transposed);
    f.add_product::<N>(n, noise, transposed, out);
    kernel::mirror(n, out);
}
