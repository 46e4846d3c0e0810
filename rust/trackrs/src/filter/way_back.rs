//! The way back of the smoother with sizes known to the compiler: the same operations in the same order as those of
//! [`super::link`], on arrays of constant size.
//!
//! | symbol   | name here       | shape  | meaning                                                             |
//! |----------|-----------------|--------|---------------------------------------------------------------------|
//! | P_{i−1}  | `before`        | N×N    | covariance of epoch i−1 given the data to i−1                       |
//! | P⁻, F, Q | `predicted`, `f`, `q` | N×N | of the step from i−1 to i                                        |
//! | P_i      | `later`         | N×N    | covariance of epoch i given all data                                |
//! | Cᵀ, C    | `back`, `gain`  | N×N    | smoother gain                                                       |
//! | D        | `rest`          | N×N    | (I − C F) P_{i−1} (I − C F)ᵀ + C Q Cᵀ                               |
//!
//! 1. C = P_{i−1} Fᵀ (P⁻)⁻¹, by solving with the Cholesky factor of P⁻, and D
//! 2. lag one P_i Cᵀ,  x = x_{i−1} + C (x_i − x⁻),  P = D + C P_i Cᵀ
//!
//! Of epochs with the same covariances C and D are made once, and so is P where P_i is the same too: in a steady state every
//! step back is that of the means alone, with the same bits. States with an attitude, steps without motion and noise and those whose P⁻
//! has no factor are left to the general path.
//!
//! Both equations are compiled for the registers of the machine too (`lanes::Level`), for states long enough to gain by it; a
//! wider register changes no bit.
//!
//! Reference: see [`super::smoother`].

use pulp::{Arch, Simd, WithSimd};

use super::link::LITTLE;
use super::smoother::{Epoch, SmoothedRun};
use crate::gaussian::{Gaussian, GaussianRef};
use crate::linalg::fixed::{
    Factor, add_product_lower, add_scaled, mirror, multiply, multiply_sparse, same_bits, transpose,
};

/// States so short gain nothing by wider registers.
const NARROW: usize = 4;

/// The way back of states of one size.
pub(super) trait WayBack {
    /// Goes from `now`, the estimate of the last epoch, back along the epochs as far as it can, and adds what it leaves
    /// behind to `run`; the number of steps.
    fn through(&mut self, epochs: &[Epoch<'_>], now: &mut Gaussian, run: &mut SmoothedRun) -> usize;
}

/// The way back of states of length n, where that is a size that is compiled.
pub(super) fn way_back(n: usize, arch: Arch) -> Option<Box<dyn WayBack>> {
    match n {
        2 => Some(Box::new(Fixed::<2>::new(arch))),
        3 => Some(Box::new(Fixed::<3>::new(arch))),
        4 => Some(Box::new(Fixed::<4>::new(arch))),
        6 => Some(Box::new(Fixed::<6>::new(arch))),
        9 => Some(Box::new(Fixed::<9>::new(arch))),
        18 => Some(Box::new(Fixed::<18>::new(arch))),
        _ => None,
    }
}

/// What the last step was, for the next one.
struct Fixed<const N: usize> {
    arch: Arch,
    link: Option<Link<N>>,
    smoothed: Option<Smoothed<N>>,
}

/// Equation 1, with what it is made of.
struct Link<const N: usize> {
    before: [[f64; N]; N],
    predicted: [[f64; N]; N],
    f: [[f64; N]; N],
    q: [[f64; N]; N],
    back: [[f64; N]; N],
    gain: [[f64; N]; N],
    rest: [[f64; N]; N],
}

/// The covariances of equation 2, with what they are made of beside the link.
struct Smoothed<const N: usize> {
    later: [[f64; N]; N],
    lag_one: [[f64; N]; N],
    cov: [[f64; N]; N],
}

impl<const N: usize> WayBack for Fixed<N> {
    fn through(&mut self, epochs: &[Epoch<'_>], now: &mut Gaussian, run: &mut SmoothedRun) -> usize {
        let (Some(mut x), Some(mut p)) = (
            now.mean.as_slice().first_chunk::<N>().copied(),
            square::<N>(now.cov.as_slice()).copied(),
        ) else {
            return 0;
        };
        let mut taken = 0;
        for pair in epochs.windows(2).rev() {
            if self.step(&pair[0], &pair[1], &mut x, &mut p, run).is_none() {
                break;
            }
            taken += 1;
        }
        now.mean.copy_from_slice(&x);
        now.cov.as_mut_slice().copy_from_slice(p.as_flattened());
        taken
    }
}

impl<const N: usize> Fixed<N> {
    fn new(arch: Arch) -> Self {
        Self {
            arch,
            link: None,
            smoothed: None,
        }
    }

    #[inline(always)]
    fn step(
        &mut self,
        earlier: &Epoch<'_>,
        epoch: &Epoch<'_>,
        x: &mut [f64; N],
        p: &mut [[f64; N]; N],
        run: &mut SmoothedRun,
    ) -> Option<()> {
        if epoch.space.attitude.is_some() {
            return None;
        }
        let before = square::<N>(earlier.filtered.cov)?;
        let predicted = square::<N>(epoch.predicted.cov)?;
        let (f, q) = (square::<N>(epoch.transition)?, square::<N>(epoch.noise)?);
        let same = self.link.as_ref().is_some_and(|link| {
            same_bits(&link.before, before)
                && same_bits(&link.predicted, predicted)
                && same_bits(&link.f, f)
                && same_bits(&link.q, q)
        });
        if !same {
            let parts = Linking {
                before,
                predicted,
                f,
                q,
            };
            let link = if N > NARROW {
                self.arch.dispatch(parts)
            } else {
                parts.link()
            };
            (self.link, self.smoothed) = (link, None);
        }
        let link = self.link.as_ref()?;
        if !self.smoothed.as_ref().is_some_and(|known| same_bits(&known.later, p)) {
            self.smoothed = None;
        }
        let arch = self.arch;
        let smoothed = self.smoothed.get_or_insert_with(|| {
            if N > NARROW {
                arch.dispatch(Smoothing { link, later: p })
            } else {
                link.smooth(p)
            }
        });
        run.lag_one.push(smoothed.lag_one.as_flattened());
        run.states.push(GaussianRef {
            mean: &*x,
            cov: p.as_flattened(),
        });
        let mut mean = *earlier.filtered.mean.first_chunk::<N>()?;
        let known = epoch.predicted.mean.first_chunk::<N>()?;
        for ((row, x), known) in link.back.iter().zip(&*x).zip(known) {
            add_scaled(&mut mean, x - known, row);
        }
        (*x, *p) = (mean, smoothed.cov);
        Some(())
    }
}

/// What a link is made of.
struct Linking<'a, const N: usize> {
    before: &'a [[f64; N]; N],
    predicted: &'a [[f64; N]; N],
    f: &'a [[f64; N]; N],
    q: &'a [[f64; N]; N],
}

impl<const N: usize> WithSimd for Linking<'_, N> {
    type Output = Option<Link<N>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Option<Link<N>> {
        self.link()
    }
}

impl<const N: usize> Linking<'_, N> {
    #[inline(always)]
    fn link(self) -> Option<Link<N>> {
        Link::new(self.before, self.predicted, self.f, self.q)
    }
}

struct Smoothing<'a, const N: usize> {
    link: &'a Link<N>,
    later: &'a [[f64; N]; N],
}

impl<const N: usize> WithSimd for Smoothing<'_, N> {
    type Output = Smoothed<N>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Smoothed<N> {
        self.link.smooth(self.later)
    }
}

impl<const N: usize> Link<N> {
    #[inline(always)]
    fn new(before: &[[f64; N]; N], predicted: &[[f64; N]; N], f: &[[f64; N]; N], q: &[[f64; N]; N]) -> Option<Self> {
        let one = |i, k| if i == k { 1.0 } else { 0.0 };
        let still = (0..N).all(|i| (0..N).all(|k| f[i][k] == one(i, k) && q[i][k] == 0.0));
        if still {
            return None;
        }
        let lower = Factor::new(predicted)?;
        for (i, row) in predicted.iter().enumerate() {
            // By factors, or refused: `link.rs`.
            if lower.diagonal(i) * lower.diagonal(i) < LITTLE * row[i] {
                return None;
            }
        }
        let mut back = multiply_sparse(f, before);
        lower.solve_lower(&mut back);
        lower.solve_upper(&mut back);
        let gain = transpose(&back);
        let mut left = multiply(&gain, f);
        for (i, row) in left.iter_mut().enumerate() {
            for (k, x) in row.iter_mut().enumerate() {
                *x = one(i, k) - *x;
            }
        }
        let mut rest = [[0.0; N]; N];
        add_product_lower(&multiply(&left, before), &transpose(&left), &mut rest);
        add_product_lower(&multiply(&gain, q), &back, &mut rest);
        mirror(&mut rest);
        Some(Self {
            before: *before,
            predicted: *predicted,
            f: *f,
            q: *q,
            back,
            gain,
            rest,
        })
    }

    #[inline(always)]
    fn smooth(&self, later: &[[f64; N]; N]) -> Smoothed<N> {
        let mut cov = self.rest;
        add_product_lower(&multiply(&self.gain, later), &self.back, &mut cov);
        mirror(&mut cov);
        Smoothed {
            later: *later,
            lag_one: multiply(later, &self.back),
            cov,
        }
    }
}

/// A matrix given row by row.
#[inline(always)]
fn square<const N: usize>(values: &[f64]) -> Option<&[[f64; N]; N]> {
    values.as_chunks::<N>().0.first_chunk::<N>()
}
