//! Whether covariances in lanes are nearly singular, without a factorisation at every step.
//!
//! det P is carried along as a bound from below: |F| = 1, Q adds at least det Q (Minkowski), and an update makes it |R|/|S| of what
//! it was.
//! The least part that is left of a component's variance once others are known is at least det P/Π P_ii. Only where the bound
//! does not keep that above [`SURE`] for a P⁻ or P, P is factored, P = L Δ Lᵀ, and the bound begins again at Π Δ_j.
//! P is at least |R|/|S| of P⁻ then (in the order of matrices), so that rounding moves neither by more than 1e-4 or so of itself.

use pulp::Simd;

use super::block::{LANES, at};
use super::kinematic::{after, less};
use crate::linalg::kernel::NEARLY_SINGULAR;

/// So large a part of Π P_ii that neither P⁻ nor P can be nearly singular, and rounding does not count.
const SURE: f64 = 1e-11;

/// What is known of the condition of some covariances.
pub(super) struct Condition<S: Simd> {
    /// The bound.
    pub(super) det: S::f64s,
    /// 1 where a covariance was nearly singular.
    pub(super) singular: S::f64s,
}

impl<S: Simd> Condition<S> {
    /// Looks at P, of which Π P_ii is `scale` at most.
    #[inline(always)]
    pub(super) fn check<const N: usize, const PN: usize>(&mut self, simd: S, p: &[S::f64s; PN], scale: S::f64s) {
        let little = simd.mul_f64s(simd.splat_f64s(SURE), scale);
        if !all(simd, simd.less_than_f64s(little, self.det)) {
            self.factor::<N, PN>(simd, p);
        }
    }

    /// The determinants themselves, and which covariances are nearly singular.
    #[inline(always)]
    fn factor<const N: usize, const PN: usize>(&mut self, simd: S, p: &[S::f64s; PN]) {
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let limit = simd.splat_f64s(NEARLY_SINGULAR);
        let mut a = *p;
        self.det = one;
        for j in 0..N {
            let pivot = a[at(j, j)];
            self.det = simd.mul_f64s(self.det, pivot);
            let enough = simd.less_than_f64s(simd.mul_f64s(limit, p[at(j, j)]), pivot);
            self.singular = simd.select_f64s(enough, self.singular, one);
            let inverse = simd.div_f64s(one, simd.select_f64s(enough, pivot, one));
            for i in after(j)..N {
                let part = simd.mul_f64s(a[at(i, j)], inverse);
                for k in after(j)..after(i) {
                    a[at(i, k)] = less(simd, a[at(i, k)], part, a[at(k, j)]);
                }
            }
        }
        // Of a product that is no number nothing is known.
        let known = simd.less_than_f64s(zero, self.det);
        self.det = simd.select_f64s(known, self.det, simd.splat_f64s(f64::NEG_INFINITY));
    }
}

/// Whether all lanes are true.
#[inline(always)]
fn all<S: Simd>(simd: S, mask: S::m64s) -> bool {
    if S::F64_LANES == LANES {
        // Their truth is a byte.
        return simd.first_true_m64s(simd.not_m64s(mask)) == LANES;
    }
    let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
    simd.reduce_min_f64s(simd.select_f64s(mask, one, zero)) > 0.0
}

/// Π P_ii.
#[inline(always)]
pub(super) fn variances<S: Simd, const N: usize, const PN: usize>(simd: S, p: &[S::f64s; PN]) -> S::f64s {
    let mut product = p[0];
    for i in 1..N {
        product = simd.mul_f64s(product, p[at(i, i)]);
    }
    product
}
