//! What goes into [`marginals`](super): per track the weight of being missed and of every report in its gate.
//!
//! Rows lie one after the other (compressed rows), because most pairs of a scan are not gated.

use crate::error::{Error, Result, require_size};

/// Whether weights are given as they are or by their logarithms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Domain {
    /// Weights; 0 = impossible.
    Linear,
    /// Natural logarithms of weights; −∞ = impossible.
    Log,
}

/// A report in a track's gate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Index of the report.
    pub report: usize,
    /// Its weight against clutter, P_D f / λ, or the logarithm of that.
    pub weight: f64,
}

/// Differences of logarithms beyond this would have lost the digits that decide.
const LARGEST_LOG: f64 = 1e12;

/// The weights of a scan, track by track.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    domain: Domain,
    reports: usize,
    misses: Vec<f64>,
    starts: Vec<usize>,
    candidates: Vec<Candidate>,
}

impl Weights {
    /// No tracks yet, and this number of reports.
    pub fn new(reports: usize, domain: Domain) -> Self {
        Self {
            domain,
            reports,
            misses: Vec::new(),
            starts: vec![0],
            candidates: Vec::new(),
        }
    }

    /// Adds a track: the weight of no report being its own, and its gated reports in increasing order.
    pub fn push(&mut self, miss: f64, candidates: impl IntoIterator<Item = Candidate>) -> Result<()> {
        let track = self.misses.len();
        self.check(miss, track, 0)?;
        let start = self.candidates.len();
        let mut fewest = 0;
        for candidate in candidates {
            if candidate.report < fewest || candidate.report >= self.reports {
                let name = format!("report of track {track}");
                let requirement = format!("must be below {} and increase along the row", self.reports);
                self.candidates.truncate(start);
                return Err(Error::invalid(&name, candidate.report, &requirement));
            }
            fewest = candidate.report + 1;
            if let Err(error) = self.check(candidate.weight, track, candidate.report + 1) {
                self.candidates.truncate(start);
                return Err(error);
            }
            self.candidates.push(candidate);
        }
        self.end_row(miss, start)
    }

    /// The candidates from `start` on are a track's.
    fn end_row(&mut self, miss: f64, start: usize) -> Result<()> {
        let zero = self.zero();
        if miss == zero
            && self.candidates[start..]
                .iter()
                .all(|candidate| candidate.weight == zero)
        {
            self.candidates.truncate(start);
            let requirement = "a track that gates no report must be able to go without one";
            return Err(Error::invalid(
                &format!("weights[{}, 0]", self.tracks()),
                miss,
                requirement,
            ));
        }
        self.misses.push(miss);
        self.starts.push(self.candidates.len());
        Ok(())
    }

    /// From a matrix (tracks, 1 + reports), row-major: column 0 = missed, column j = report j − 1. Candidates are the
    /// reports of weight other than 0.
    pub fn from_dense(values: &[f64], tracks: usize, columns: usize, domain: Domain) -> Result<Self> {
        require_size("weights", tracks.saturating_mul(columns), values.len())?;
        if columns == 0 {
            let requirement = "column 0 is the weight of a missed track";
            return Err(Error::invalid("number of columns of weights", columns, requirement));
        }
        let mut weights = Self::new(columns - 1, domain);
        weights.misses.reserve(tracks);
        weights.starts.reserve(tracks);
        weights.candidates.reserve(tracks.saturating_mul((columns - 1).min(8)));
        let zero = weights.zero();
        for (track, row) in values.chunks_exact(columns).enumerate() {
            weights.check(row[0], track, 0)?;
            let start = weights.candidates.len();
            for (report, &weight) in row[1..].iter().enumerate() {
                if weight != zero {
                    weights.check(weight, track, report + 1)?;
                    weights.candidates.push(Candidate { report, weight });
                }
            }
            weights.end_row(row[0], start)?;
        }
        Ok(weights)
    }

    /// Number of tracks.
    pub fn tracks(&self) -> usize {
        self.misses.len()
    }

    /// Number of reports.
    pub fn reports(&self) -> usize {
        self.reports
    }

    /// The possible reports of a track.
    pub fn candidates(&self, track: usize) -> &[Candidate] {
        &self.candidates[self.row(track)]
    }

    /// Where a track's candidates are among those of all tracks.
    pub(super) fn row(&self, track: usize) -> std::ops::Range<usize> {
        self.starts[track]..self.starts[track + 1]
    }

    pub(super) fn starts(&self) -> &[usize] {
        &self.starts
    }

    pub(super) fn all(&self) -> &[Candidate] {
        &self.candidates
    }

    pub(super) fn miss(&self, track: usize) -> f64 {
        self.misses[track]
    }

    /// The value that means impossible.
    pub(super) fn zero(&self) -> f64 {
        match self.domain {
            Domain::Linear => 0.0,
            Domain::Log => f64::NEG_INFINITY,
        }
    }

    /// `value` as a share of `largest`, which is not less.
    pub(super) fn ratio(&self, value: f64, largest: f64) -> f64 {
        if value == self.zero() {
            return 0.0;
        }
        match self.domain {
            Domain::Linear => value / largest,
            Domain::Log => libm::exp(value - largest),
        }
    }

    /// The logarithm of the weight that `value` stands for.
    pub(super) fn log(&self, value: f64) -> f64 {
        match self.domain {
            Domain::Linear => libm::log(value),
            Domain::Log => value,
        }
    }

    #[inline]
    fn check(&self, value: f64, track: usize, column: usize) -> Result<()> {
        let usable = match self.domain {
            Domain::Linear => (0.0..f64::INFINITY).contains(&value),
            Domain::Log => value.abs() <= LARGEST_LOG || value == f64::NEG_INFINITY,
        };
        if usable {
            return Ok(());
        }
        if value.is_nan() || value == f64::INFINITY {
            return Err(Error::NonFinite {
                what: format!("weights[{track}, {column}]"),
                index: track * (self.reports + 1) + column,
            });
        }
        let name = format!("weights[{track}, {column}]");
        Err(Error::invalid(
            &name,
            value,
            match self.domain {
                Domain::Linear => "a weight must not be negative",
                Domain::Log => "the logarithm of a weight must lie within 1e12 of 0, or be -inf",
            },
        ))
    }
}
