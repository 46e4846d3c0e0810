//! Reports in the cells of a grid, so that a gate looks only at those that its box can hold.
//!
//! The grid lies over the two components in which the reports spread most, measured in gates: rows about as high as a gate
//! in the second of them, and in a row narrow cells along the first. A gate looks at one run of cells in each row that its
//! box touches. Which cell a number falls into rises with the number, rounded as it may be, so that no report of the box is
//! passed over. A cell that holds many is kept in the order of the first component and cut by bisection: where reports lie
//! in a few heaps far from one another, and the grid says little, it is a sorted sweep.

use super::distances::Expected;
use super::sweep::reach;

/// Reports that a cell holds without an order.
const CROWD: usize = 32;

/// Cells for a report.
const CELLS: f64 = 2.0;

/// Reports without those with a NaN, which no gate holds.
pub(super) struct Grid {
    threshold: f64,
    along: Axis,
    across: Axis,
    /// Where each cell begins among the reports, row after row, and where the last one ends.
    starts: Vec<usize>,
    /// Reports cell by cell, and zeros behind them.
    pub(super) order: Vec<usize>,
    /// Their components, and NaN behind them.
    pub(super) columns: Vec<Vec<f64>>,
}

/// A component in cells of one length.
struct Axis {
    component: usize,
    low: f64,
    per_length: f64,
    /// The last cell.
    last: f64,
}

/// What of the grid the box of a gate touches.
pub(super) struct Patch {
    /// From where to where it reaches in the first component.
    low: f64,
    high: f64,
    /// The first and the last of each.
    cells: [usize; 2],
    rows: [usize; 2],
}

/// How far the finite reports reach in a component.
struct Span {
    component: usize,
    low: f64,
    high: f64,
    gates: f64,
}

impl Axis {
    fn new(span: &Span, cells: f64) -> Self {
        Self {
            component: span.component,
            low: span.low,
            per_length: cells / (span.high - span.low),
            last: cells - 1.0,
        }
    }

    /// Numbers outside fall into the cells at the ends.
    #[inline]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn cell(&self, at: f64) -> usize {
        let cell = (at - self.low) * self.per_length;
        // Written out, each is one instruction; a NaN falls into the first cell.
        let cell = if cell > 0.0 { cell } else { 0.0 };
        (if cell < self.last { cell } else { self.last }) as u32 as usize
    }
}

impl Span {
    fn new(component: usize, expected: &Expected<'_>, reports: &[f64], threshold: f64) -> Self {
        let m = expected.dims;
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for report in reports.chunks_exact(m) {
            let value = report[component];
            if value.is_finite() {
                low = if value < low { value } else { low };
                high = if value > high { value } else { high };
            }
        }
        let covs = expected.covs.chunks_exact(m * m);
        let tracks = covs.len() as f64;
        let variance = covs.map(|cov| cov[component * (m + 1)]).sum::<f64>() / tracks;
        Self {
            component,
            low,
            high,
            gates: (high - low) / (2.0 * (threshold * variance).sqrt()),
        }
    }
}

impl Grid {
    /// Of reports in gates of this threshold, with `padding` entries behind them.
    pub(super) fn new(expected: &Expected<'_>, reports: &[f64], threshold: f64, padding: usize) -> Self {
        let (m, threshold) = (expected.dims, threshold.max(0.0));
        let mut spans: Vec<Span> = (0..m)
            .map(|component| Span::new(component, expected, reports, threshold))
            .collect();
        spans.sort_by(|a, b| b.gates.total_cmp(&a.gates));
        let count = (reports.len() / m) as f64;
        let rows = match &spans[..] {
            [_, second, ..] => second.gates.min(count.sqrt()).max(1.0).floor(),
            _ => 1.0,
        };
        let along = Axis::new(&spans[0], (CELLS * count / rows).max(1.0).floor());
        let across = Axis::new(&spans[spans.len().min(2) - 1], rows);
        let mut grid = Self {
            starts: vec![0; (along.cells() * across.cells()) + 1],
            threshold,
            along,
            across,
            order: Vec::new(),
            columns: Vec::new(),
        };
        grid.fill(m, reports, padding);
        grid
    }

    fn fill(&mut self, m: usize, reports: &[f64], padding: usize) {
        let mut cells = Vec::with_capacity(reports.len() / m);
        for (report, values) in reports.chunks_exact(m).enumerate() {
            let cell = self.cell(values[self.along.component], values[self.across.component]);
            if !values.iter().any(|value| value.is_nan()) {
                self.starts[cell] += 1;
                cells.push((cell, report));
            }
        }
        let (mut sum, mut most) = (0, 0);
        for start in &mut self.starts {
            most = most.max(*start);
            sum += *start;
            *start = sum;
        }
        self.order = vec![0; sum + padding];
        for &(cell, report) in &cells {
            let start = &mut self.starts[cell];
            *start -= 1;
            self.order[*start] = report;
        }
        let order = &mut self.order[..sum];
        if most > CROWD {
            let key = |report: usize| reports[report * m + self.along.component];
            for ends in self.starts.windows(2) {
                if ends[1] - ends[0] > CROWD {
                    order[ends[0]..ends[1]].sort_unstable_by(|&a, &b| key(a).total_cmp(&key(b)));
                }
            }
        }
        self.columns = vec![vec![f64::NAN; sum + padding]; m];
        for (k, column) in self.columns.iter_mut().enumerate() {
            for (value, &report) in column.iter_mut().zip(&*order) {
                *value = reports[report * m + k];
            }
        }
    }

    #[inline]
    fn cell(&self, along: f64, across: f64) -> usize {
        self.across.cell(across) * self.along.cells() + self.along.cell(along)
    }

    /// The boxes of all gates.
    pub(super) fn patches(&self, expected: &Expected<'_>) -> Vec<Patch> {
        let m = expected.dims;
        let of = |axis: &Axis, center: &[f64], cov: &[f64]| {
            let k = axis.component;
            reach(center[k], (self.threshold * cov[k * (m + 1)]).sqrt()).into_inner()
        };
        let tracks = expected.means.chunks_exact(m).zip(expected.covs.chunks_exact(m * m));
        tracks
            .map(|(center, cov)| {
                let (low, high) = of(&self.along, center, cov);
                let (bottom, top) = of(&self.across, center, cov);
                Patch {
                    low,
                    high,
                    cells: [self.along.cell(low), self.along.cell(high)],
                    rows: [self.across.cell(bottom), self.across.cell(top)],
                }
            })
            .collect()
    }

    /// From where to where in the order a gate must look, put into `out`.
    #[inline]
    pub(super) fn windows(&self, patch: &Patch, out: &mut Vec<(usize, usize)>) {
        out.clear();
        let keys = &self.columns[self.along.component];
        let ([left, right], [bottom, top]) = (patch.cells, patch.rows);
        for row in bottom..=top {
            let row = &self.starts[row * self.along.cells()..];
            let (mut from, mut to) = (row[left], row[right + 1]);
            if row[left + 1] - from > CROWD {
                from += keys[from..row[left + 1]].partition_point(|&key| key < patch.low);
            }
            let last = row[right].max(from);
            if to - last > CROWD {
                to = last + keys[last..to].partition_point(|&key| key <= patch.high);
            }
            if from < to {
                out.push((from, to));
            }
        }
    }
}

impl Axis {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn cells(&self) -> usize {
        self.last as usize + 1
    }
}
