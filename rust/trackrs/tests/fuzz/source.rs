//! Arguments drawn from bytes.

use nalgebra::{DMatrix, DVector};
use trackrs::{Error, Gaussian};

/// Bytes on their way to be arguments; when they run out zeros follow.
pub(crate) struct Source<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Of 256 numbers so many are wild.
    wild: u8,
    scale: f64,
}

impl<'a> Source<'a> {
    /// A source whose first byte says how wild its numbers are and how large.
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        let mut source = Self {
            bytes,
            at: 0,
            wild: 0,
            scale: 1.0,
        };
        source.wild = [0, 0, 0, 2, 8, 60, 255, 0][source.below(8)];
        source.scale = [1.0, 1.0, 1.0, 1.0, 1e-9, 1e7, 1e-160, 1e155][source.below(8)];
        source
    }

    /// What is left.
    pub(crate) fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    pub(crate) fn byte(&mut self) -> u8 {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        byte
    }

    /// A number below `n`.
    pub(crate) fn below(&mut self, n: usize) -> usize {
        usize::from(self.byte()) % n
    }

    pub(crate) fn coin(&mut self) -> bool {
        self.byte() & 1 == 1
    }

    /// Mostly what is asked for, in one of 64 cases one more or less.
    pub(crate) fn about(&mut self, size: usize) -> usize {
        match self.byte() {
            0..=1 => size.saturating_sub(1),
            2..=3 => size + 1,
            _ => size,
        }
    }

    fn bits(&mut self) -> u64 {
        (0..8).fold(0, |bits, _| bits << 8 | u64::from(self.byte()))
    }

    /// An ordinary number within ±100.
    pub(crate) fn tame(&mut self) -> f64 {
        let bits = i16::from_le_bytes([self.byte(), self.byte()]);
        f64::from(bits) / 327.68
    }

    /// Any number: an ordinary one at the source's scale, or one that breaks things.
    pub(crate) fn number(&mut self) -> f64 {
        if self.byte() >= self.wild {
            return self.tame() * self.scale;
        }
        match self.below(12) {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => f64::NEG_INFINITY,
            3 => -0.0,
            4 => 5e-324,
            5 => f64::MAX,
            6 => -1e300,
            7 => 1e-300,
            8 => 0.0,
            _ => f64::from_bits(self.bits()),
        }
    }

    /// A number that is mostly positive.
    pub(crate) fn positive(&mut self) -> f64 {
        let value = self.number();
        if self.byte() < 4 {
            value
        } else {
            value.abs() + 1e-3 * self.scale
        }
    }

    /// A number mostly within [0, 1].
    pub(crate) fn share(&mut self) -> f64 {
        if self.byte() < 4 {
            self.number()
        } else {
            f64::from(self.byte()) / 255.0
        }
    }

    pub(crate) fn numbers(&mut self, count: usize) -> Vec<f64> {
        (0..count).map(|_| self.number()).collect()
    }

    pub(crate) fn positives(&mut self, count: usize) -> Vec<f64> {
        (0..count).map(|_| self.positive()).collect()
    }

    pub(crate) fn vector(&mut self, n: usize) -> DVector<f64> {
        DVector::from_vec(self.numbers(n))
    }

    pub(crate) fn matrix(&mut self, rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_vec(rows, columns, self.numbers(rows * columns))
    }

    /// Mostly a covariance: regular, singular, or badly scaled; sometimes any matrix.
    pub(crate) fn covariance(&mut self, n: usize) -> DMatrix<f64> {
        match self.below(16) {
            0 => self.matrix(n, n),
            1 => DMatrix::zeros(n, n),
            2 => {
                let half = self.matrix(n, n.div_ceil(2));
                &half * half.transpose()
            }
            3 => {
                let scales = self.numbers(n);
                DMatrix::from_fn(n, n, |i, j| if i == j { scales[i].abs() } else { 0.0 })
            }
            _ => {
                let half = self.matrix(n, n);
                let full = &half * half.transpose();
                (&full + full.transpose()) * 0.5 + DMatrix::identity(n, n) * (1e-3 * self.scale * self.scale)
            }
        }
    }

    pub(crate) fn gaussian(&mut self, n: usize) -> Result<Gaussian, Error> {
        Gaussian::new(self.vector(n), self.covariance(n))
    }

    /// Times that mostly do not decrease.
    pub(crate) fn times(&mut self, count: usize) -> Vec<f64> {
        let mut now = 0.0;
        (0..count)
            .map(|_| {
                now += if self.byte() < self.wild {
                    self.number()
                } else {
                    f64::from(self.byte()) / 64.0
                };
                now
            })
            .collect()
    }
}

/// Fails where a result holds what is no number.
pub(crate) fn finite<'v>(what: &str, values: impl IntoIterator<Item = &'v f64>) {
    for value in values {
        assert!(value.is_finite(), "{what}: {value}");
    }
}
