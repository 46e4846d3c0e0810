//! Eight tracks side by side: the same entry of all of them is one cache line.

/// One entry of eight tracks.
#[repr(C, align(64))]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lane(pub [f64; LANES]);

/// Tracks in a block.
pub const LANES: usize = 8;

/// Means and covariances of eight tracks with N states; PN = N (N + 1) / 2 entries of the lower triangle, row by row.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Block<const N: usize, const PN: usize> {
    /// Means.
    pub mean: [Lane; N],
    /// Covariances.
    pub cov: [Lane; PN],
    /// What the determinants of the covariances are at least; −∞ where that is not known.
    pub det: Lane,
}

/// Where the entry (i, j) of a symmetric matrix stands in its lower triangle.
#[inline(always)]
pub const fn at(i: usize, j: usize) -> usize {
    if i >= j {
        i * (i + 1) / 2 + j
    } else {
        j * (j + 1) / 2 + i
    }
}

/// The largest absolute value; what is NaN does not count. Eight at a time, so that they share registers.
pub(crate) fn largest(values: &[f64]) -> f64 {
    let larger = |a: f64, b: f64| if b > a { b } else { a };
    let (blocks, rest) = values.as_chunks::<LANES>();
    let mut most = [0.0; LANES];
    for block in blocks {
        for (most, value) in most.iter_mut().zip(block) {
            *most = larger(*most, value.abs());
        }
    }
    most.into_iter()
        .chain(rest.iter().map(|value| value.abs()))
        .fold(0.0, larger)
}

impl<const N: usize, const PN: usize> Block<N, PN> {
    /// Eight tracks at the origin with unit covariances: what fills the last block up.
    pub fn padding() -> Self {
        let mut block = Self {
            mean: [Lane([0.0; LANES]); N],
            cov: [Lane([0.0; LANES]); PN],
            det: Lane([f64::NEG_INFINITY; LANES]),
        };
        for i in 0..N {
            block.cov[at(i, i)] = Lane([1.0; LANES]);
        }
        block
    }

    /// Puts a track into a lane: its mean, and its covariance N×N row by row, of which the lower triangle is read.
    pub fn set(&mut self, lane: usize, mean: &[f64], cov: &[f64]) {
        self.det.0[lane] = f64::NEG_INFINITY;
        for (to, from) in self.mean.iter_mut().zip(mean) {
            to.0[lane] = *from;
        }
        for i in 0..N {
            for j in 0..=i {
                self.cov[at(i, j)].0[lane] = cov[i * N + j];
            }
        }
    }

    /// Makes a lane that of another block.
    pub(crate) fn put_back(&mut self, lane: usize, from: &Self) {
        let pairs = self.mean.iter_mut().zip(&from.mean);
        let pairs = pairs.chain(self.cov.iter_mut().zip(&from.cov));
        for (to, from) in pairs.chain([(&mut self.det, &from.det)]) {
            to.0[lane] = from.0[lane];
        }
    }

    /// Reads a track.
    pub fn get(&self, lane: usize, mean: &mut [f64], cov: &mut [f64]) {
        for (to, from) in mean.iter_mut().zip(&self.mean) {
            *to = from.0[lane];
        }
        for i in 0..N {
            for j in 0..N {
                cov[i * N + j] = self.cov[at(i, j)].0[lane];
            }
        }
    }
}
