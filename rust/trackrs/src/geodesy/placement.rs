//! An array surveyed in its own frame, placed in a local north-east-down frame by the elements that have a GPS fix.
//!
//! | symbol   | name here  | shape | meaning                                                        |
//! |----------|------------|-------|----------------------------------------------------------------|
//! | pᵢ       | `elements` | 3     | element i in the array's own right-handed frame, metres        |
//! | p′ᵢ, Cᵢ  | `fixes`    | 3,3×3 | its GPS fix in NED about the origin, and the covariance of that |
//! | s, R, t  | [`Similarity`] |   | p′ = t + s R p                                                 |
//! | Aᵢ, vᵢ   |            | 3×7,3 | as in [`super::similarity`]                                    |
//!
//! p′ᵢ = NED(fix),  Cᵢ = T diag(σ_N², σ_E², σ_D²) Tᵀ, T from the NED axes at the fix to those at the origin
//! start:    Umeyama's closed form with weights 3 / tr Cᵢ
//! repeat:   x = (Σ Aᵢᵀ Cᵢ⁻¹ Aᵢ)⁻¹ Σ Aᵢᵀ Cᵢ⁻¹ vᵢ,  μ′ += δc,  s ← s exp λ,  R ← exp(ω×) R
//! cov of (μ′, ln s, ω) = (Σ Aᵢᵀ Cᵢ⁻¹ Aᵢ)⁻¹,  χ² = Σ vᵢᵀ Cᵢ⁻¹ vᵢ with 3m − 7 degrees of freedom for m fixes
//! element:  p′ = t + s R p,  P′ = A cov Aᵀ
//!
//! The closed form knows one variance per point, while GPS heights are worse than its horizontal coordinates: hence the
//! Gauss-Newton steps. The standard deviations are taken at their word; χ² far above its degrees of freedom says
//! that they, or the array's survey, are not right. The survey itself counts as exact.
//! References: Umeyama (1991), see [`super::similarity`]; Koch (1999), Parameter estimation and hypothesis testing in
//! linear models, §3.2.

use nalgebra::{Matrix3, Vector3};

use super::local::{Axes, LocalFrame, turned};
use super::similarity::{PointEstimate, Similarity, fit_named, normal_equations};
use super::wgs84::Geodetic;
use crate::error::{Error, Result, all_finite, require_finite, require_size, require_std};

const MAX_STEPS: usize = 50;
/// The steps end when the correction is below this share of the size of the array.
const TOLERANCE: f64 = 1e-10;

/// A GPS position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// Where.
    pub position: Geodetic,
    /// Standard deviations to the north, to the east and downwards, metres.
    pub std: [f64; 3],
}

/// An array in the common frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// Every element in NED about the origin, with its covariance.
    pub elements: Vec<PointEstimate>,
    /// From the array's frame to NED; its covariance follows from the standard deviations of the fixes.
    pub similarity: Similarity,
    /// Fix minus placed element in NED, metres; none where there is no fix.
    pub residuals: Vec<Option<Vector3<f64>>>,
    /// Σ vᵀ C⁻¹ v; chi-square with `dof` degrees of freedom if everything is right.
    pub chi_square: f64,
    /// 3m − 7 for m fixes.
    pub dof: usize,
    /// `chi_square` / `dof`, 1 if everything is right.
    pub variance: f64,
}

impl Placement {
    /// For every element the standard deviation of its position in the direction where it is largest, metres: a bound on the
    /// error that the placement makes of a range to it, whatever the direction of the target.
    pub fn survey_std(&self) -> Vec<f64> {
        let largest = |point: &PointEstimate| point.cov.symmetric_eigenvalues().max().max(0.0).sqrt();
        self.elements.iter().map(largest).collect()
    }
}

/// Places an array in NED (z down) about `origin`. `fixes` has one entry per element, three of them or more a fix, and
/// those elements do not lie on one line.
pub fn place_array(elements: &[Vector3<f64>], fixes: &[Option<Fix>], origin: Geodetic) -> Result<Placement> {
    require_size("fixes", elements.len(), fixes.len())?;
    require_finite("elements", elements.iter().flat_map(|p| p.iter()))?;
    let frame = LocalFrame::new(origin, Axes::Ned)?;
    let (mut source, mut target, mut weights, mut information) = (vec![], vec![], vec![], vec![]);
    for (row, (element, fix)) in elements.iter().zip(fixes).enumerate() {
        let Some(fix) = fix else { continue };
        let here = Geodetic::of_row(row, fix.position.lat, fix.position.lon, fix.position.height)?;
        for std in fix.std {
            require_std(&format!("std[{row}]"), std)?;
        }
        let turn = frame.rotation() * LocalFrame::new(here, Axes::Ned)?.rotation().transpose();
        let variances = Vector3::from(fix.std.map(|s| s * s));
        source.push(*element);
        target.push(frame.from_geodetic(&here));
        weights.push(3.0 / variances.sum());
        information.push(turned(&turn, &Matrix3::from_diagonal(&variances.map(|v| 1.0 / v))));
    }
    if source.len() < 3 {
        return Err(Error::invalid(
            "fixes",
            format!("{} of {} elements", source.len(), elements.len()),
            "must be known for at least 3 elements that are not on one line",
        ));
    }
    let start = fit_named(["elements with a fix", "fixes"], &source, &target, Some(&weights))?.similarity;
    let similarity = refine(start, &source, &target, &information)?;
    let residual = |p: &Vector3<f64>, image: &Vector3<f64>| image - similarity.apply(p);
    let observed = source.iter().zip(&target).zip(&information);
    let chi_square: f64 = observed
        .map(|((p, image), w)| residual(p, image).dot(&(w * residual(p, image))))
        .sum();
    let offset = |(p, fix): (&Vector3<f64>, &Option<Fix>)| {
        let fix = fix.as_ref()?;
        Some(residual(p, &frame.from_geodetic(&fix.position)))
    };
    let dof = 3 * source.len() - 7;
    let place = |p: &Vector3<f64>| similarity.propagate(p, &Matrix3::zeros());
    let placed: Vec<PointEstimate> = elements.iter().map(place).collect();
    let finite = |p: &PointEstimate| all_finite(p.position.as_slice()) && all_finite(p.cov.as_slice());
    if !placed.iter().all(finite) {
        return Err(Error::Overflow {
            what: "placed element".into(),
        });
    }
    Ok(Placement {
        elements: placed,
        residuals: elements.iter().zip(fixes).map(offset).collect(),
        chi_square,
        dof,
        variance: chi_square / dof as f64,
        similarity,
    })
}

/// Gauss-Newton steps to the weighted least-squares solution.
fn refine(
    start: Similarity,
    source: &[Vector3<f64>],
    target: &[Vector3<f64>],
    information: &[Matrix3<f64>],
) -> Result<Similarity> {
    let mut found = start;
    for _ in 0..MAX_STEPS {
        let residuals: Vec<_> = source
            .iter()
            .zip(target)
            .map(|(p, image)| image - found.apply(p))
            .collect();
        let step = normal_equations(&found, source, information, &residuals)?;
        let x = step.correction;
        found.image += x.fixed_rows::<3>(0);
        found.scale *= libm::exp(x[3]);
        found.rotation = turn_by(&Vector3::new(x[4], x[5], x[6])) * found.rotation;
        found.centred_cov = step.cofactor;
        if step.relative <= TOLERANCE {
            return Ok(found);
        }
    }
    Err(Error::invalid(
        "fixes",
        "given",
        "must agree with the elements: the adjustment does not converge",
    ))
}

/// exp(ω×), by Rodrigues' formula.
fn turn_by(omega: &Vector3<f64>) -> Matrix3<f64> {
    let angle = omega.norm();
    if angle == 0.0 {
        return Matrix3::identity();
    }
    let axis = (omega / angle).cross_matrix();
    let half = libm::sin(0.5 * angle);
    Matrix3::identity() + axis * libm::sin(angle) + axis * axis * (2.0 * half * half)
}
