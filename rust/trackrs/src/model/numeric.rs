//! Derivatives by central differences, for models that are functions from outside.
//!
//! ∂y/∂x_j ≈ (y(x + s_j e_j) − y(x − s_j e_j)) / (2 s_j),  s_j = ∛ε max(|x_j|, 1): the step at which truncation and rounding
//! are of one size for functions whose third derivative is of the size of the first.
//! All points are given to the function at once. Angles are compared on the circle.
//! Reference: Dennis, Schnabel (1996), Numerical methods for unconstrained optimization, §5.4.

use super::sensor::wrap_angle;
use crate::error::Result;

/// ∛ε.
const STEP: f64 = 6.055_454_452_393_343e-6;

/// A function of several states of length n, one after the other, that writes a value of one length for each.
pub type Values<'a> = dyn FnMut(&[f64], &mut [f64]) -> Result<()> + 'a;

/// Writes the value at `state` and the derivative there, value length × n row by row.
pub fn differentiate(
    state: &[f64],
    angles: &[usize],
    values: &mut Values<'_>,
    value: &mut [f64],
    jacobian: &mut [f64],
) -> Result<()> {
    let (n, m) = (state.len(), value.len());
    let mut points = state.repeat(2 * n + 1);
    for j in 0..n {
        let step = STEP * state[j].abs().max(1.0);
        points[(1 + j) * n + j] += step;
        points[(1 + n + j) * n + j] -= step;
    }
    let mut images = vec![0.0; (2 * n + 1) * m];
    values(&points, &mut images)?;
    value.copy_from_slice(&images[..m]);
    for j in 0..n {
        let (plus, minus) = (1 + j, 1 + n + j);
        // What the step became by rounding.
        let width = points[plus * n + j] - points[minus * n + j];
        for i in 0..m {
            let mut rise = images[plus * m + i] - images[minus * m + i];
            if angles.contains(&i) {
                rise = wrap_angle(rise);
            }
            jacobian[i * n + j] = rise / width;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivative_of_a_bearing_also_across_the_seam() {
        let mut calls = 0;
        let mut bearing = |states: &[f64], out: &mut [f64]| {
            calls += 1;
            for (s, y) in states.chunks_exact(2).zip(out) {
                *y = s[1].atan2(s[0]);
            }
            Ok(())
        };
        for y in [0.5, 0.0] {
            let (mut value, mut slope) = ([0.0], [0.0; 2]);
            differentiate(&[-2.0, y], &[0], &mut bearing, &mut value, &mut slope).unwrap();
            let square = 4.0 + y * y;
            assert!((slope[0] + y / square).abs() < 1e-9 && (slope[1] + 2.0 / square).abs() < 1e-9);
        }
        assert_eq!(calls, 2);
    }
}
