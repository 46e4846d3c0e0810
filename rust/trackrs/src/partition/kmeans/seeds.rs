//! The first centres of k-means++ (equation 1 of [`super`]).

use crate::interrupt::ahead;
use crate::partition::points::{Points, squared};
use crate::stats::stream::Stream;

/// The first centres, row by row.
pub(super) fn seeds(points: &Points, k: usize, stream: &mut Stream) -> Vec<f64> {
    let n = points.len();
    let mut centres = Vec::with_capacity(k * points.dims());
    let indices: Vec<usize> = (0..n).collect();
    let mut nearest = vec![f64::INFINITY; n];
    let mut total = 0.0;
    for number in 0..k {
        ahead(n);
        let chosen = if number == 0 || total == 0.0 {
            stream.choice(&indices).copied().unwrap_or(0)
        } else {
            weighted(&nearest, stream.uniform() * total)
        };
        let centre = points.point(chosen);
        centres.extend_from_slice(centre);
        total = 0.0;
        for (row, d2) in points.values().chunks_exact(points.dims()).zip(&mut nearest) {
            *d2 = d2.min(squared(row, centre));
            total += *d2;
        }
    }
    centres
}

/// The first index at which the sum of the weights exceeds `target`.
fn weighted(weights: &[f64], target: f64) -> usize {
    let (mut sum, mut last) = (0.0, 0);
    for (i, &weight) in weights.iter().enumerate() {
        if weight > 0.0 {
            sum += weight;
            last = i;
            if sum > target {
                break;
            }
        }
    }
    last
}
