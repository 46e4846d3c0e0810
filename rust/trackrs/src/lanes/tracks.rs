//! Tracks in lanes, whatever their dimensions: one kernel for every number of axes and derivatives up to three.

use std::convert::Infallible;
use std::fmt::Debug;
use std::ops::Range;

use super::Level;
use super::block::{Block, LANES};
use super::kinematic::{Positions, Step};
use super::linear::Linear;
use super::work::{Measured, Outputs, TOGETHER, Work};
use crate::threads::{PARTS, share_out};

/// Per pair of blocks and axis; see [`Step::noise`]. Axes beyond those of the motion do not count.
pub(crate) type AxisNoise = [[f64; 3]; 6];

/// A step of any number of axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RawStep {
    pub(crate) dt: f64,
    pub(crate) noise: AxisNoise,
}

/// A sensor of any number of axes or components.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum RawSensor {
    /// Variances of the axes.
    Positions(Vec<f64>),
    /// z = H x + d + v with m components, at most [`super::linear::MOST`]; matrices row by row.
    Linear {
        /// H, m×n.
        rows: Vec<f64>,
        /// d.
        offset: Vec<f64>,
        /// R, m×m.
        noise: Vec<f64>,
    },
}

/// Some tracks.
pub(crate) trait Lanes: Debug + Send + Sync {
    /// Puts a track in its place; the covariance row by row.
    fn set(&mut self, track: usize, mean: &[f64], cov: &[f64]);
    /// Reads a track.
    fn get(&self, track: usize, mean: &mut [f64], cov: &mut [f64]);
    /// A copy.
    fn copied(&self) -> Box<dyn Lanes>;
    /// Takes in measurements of some tracks, from the first of a block on; all other arguments are those of these tracks
    /// ([`Work`]).
    #[allow(clippy::too_many_arguments)]
    fn advance(
        &mut self,
        tracks: Range<usize>,
        steps: &[RawStep],
        sensor: &RawSensor,
        values: &[f64],
        out: Outputs<'_>,
        failures: &mut [u64],
        singular: &mut [bool],
        level: Level,
        threads: usize,
    );
}

/// So many tracks of a motion with D axes and K blocks; `None` for more than three of either.
pub(crate) fn lanes(dims: usize, order: usize, tracks: usize) -> Option<Box<dyn Lanes>> {
    Some(match (dims, order) {
        (1, 1) => Box::new(Tracks::<1, 1, 1, 1>::new(tracks)),
        (1, 2) => Box::new(Tracks::<1, 2, 2, 3>::new(tracks)),
        (1, 3) => Box::new(Tracks::<1, 3, 3, 6>::new(tracks)),
        (2, 1) => Box::new(Tracks::<2, 1, 2, 3>::new(tracks)),
        (2, 2) => Box::new(Tracks::<2, 2, 4, 10>::new(tracks)),
        (2, 3) => Box::new(Tracks::<2, 3, 6, 21>::new(tracks)),
        (3, 1) => Box::new(Tracks::<3, 1, 3, 6>::new(tracks)),
        (3, 2) => Box::new(Tracks::<3, 2, 6, 21>::new(tracks)),
        (3, 3) => Box::new(Tracks::<3, 3, 9, 45>::new(tracks)),
        _ => return None,
    })
}

#[derive(Debug, Clone)]
struct Tracks<const D: usize, const K: usize, const N: usize, const PN: usize> {
    blocks: Vec<Block<N, PN>>,
}

impl<const D: usize, const K: usize, const N: usize, const PN: usize> Tracks<D, K, N, PN> {
    fn new(tracks: usize) -> Self {
        Self {
            blocks: vec![Block::padding(); tracks.div_ceil(LANES)],
        }
    }
}

impl<const D: usize, const K: usize, const N: usize, const PN: usize> Lanes for Tracks<D, K, N, PN> {
    fn set(&mut self, track: usize, mean: &[f64], cov: &[f64]) {
        self.blocks[track / LANES].set(track % LANES, mean, cov);
    }

    fn get(&self, track: usize, mean: &mut [f64], cov: &mut [f64]) {
        self.blocks[track / LANES].get(track % LANES, mean, cov);
    }

    fn copied(&self) -> Box<dyn Lanes> {
        Box::new(self.clone())
    }

    fn advance(
        &mut self,
        tracks: Range<usize>,
        steps: &[RawStep],
        sensor: &RawSensor,
        values: &[f64],
        out: Outputs<'_>,
        failures: &mut [u64],
        singular: &mut [bool],
        level: Level,
        threads: usize,
    ) {
        let axes = |all: [f64; 3]| std::array::from_fn(|axis| all[axis]);
        let steps: Vec<Step<D>> = steps
            .iter()
            .map(|step| Step::new::<K>(step.dt, step.noise.map(axes)))
            .collect();
        let count = tracks.len();
        let blocks = &mut self.blocks[tracks.start / LANES..tracks.end.div_ceil(LANES)];
        macro_rules! by {
            ($sensor:expr) => {
                shared(
                    Work::<_, D, K, N, PN> {
                        blocks,
                        tracks: count,
                        steps: &steps,
                        sensor: &$sensor,
                        values,
                        out,
                        failures,
                        singular,
                    },
                    level,
                    threads,
                )
            };
        }
        match sensor {
            RawSensor::Positions(variances) => by!(Positions::<D>(std::array::from_fn(|axis| variances[axis]))),
            RawSensor::Linear { rows, offset, noise } => by!(Linear::<N>::new(rows, offset, noise)),
        }
    }
}

/// Work on so many threads, some blocks each.
fn shared<M: Measured<N, PN>, const D: usize, const K: usize, const N: usize, const PN: usize>(
    whole: Work<'_, M, D, K, N, PN>,
    level: Level,
    threads: usize,
) {
    let Some(arch) = level.arch() else { return };
    if threads <= 1 {
        arch.dispatch(whole);
        return;
    }
    let share = whole.blocks.len().div_ceil(threads * PARTS).next_multiple_of(TOGETHER);
    let rows = share * LANES * whole.steps.len();
    // Chunks of what is not wanted are empty, as many as there are shares.
    let mut means = whole.out.means.chunks_mut((rows * N).max(1));
    let mut covs = whole.out.covs.chunks_mut((rows * N * N).max(1));
    let mut nis = whole.out.nis.chunks_mut(rows.max(1));
    let work = whole
        .blocks
        .chunks_mut(share)
        .zip(whole.values.chunks((rows * whole.sensor.components()).max(1)))
        .zip(whole.failures.chunks_mut(share * LANES))
        .zip(whole.singular.chunks_mut(share * LANES))
        .enumerate();
    let work = work.map(|(k, (((blocks, values), failures), singular))| Work::<M, D, K, N, PN> {
        tracks: (whole.tracks - k * share * LANES).min(share * LANES),
        blocks,
        steps: whole.steps,
        sensor: whole.sensor,
        values,
        out: Outputs {
            means: means.next().unwrap_or_default(),
            covs: covs.next().unwrap_or_default(),
            nis: nis.next().unwrap_or_default(),
        },
        failures,
        singular,
    });
    let Ok(()) = share_out(work, threads, |work| {
        arch.dispatch(work);
        Ok::<_, Infallible>(())
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nothing that comes in through a batch has such a covariance.
    #[test]
    fn a_pivot_that_is_not_positive_keeps_the_prediction_of_its_track_only() {
        let step = RawStep {
            dt: 1.0,
            noise: [[0.0; 3]; 6],
        };
        let linear = RawSensor::Linear {
            rows: vec![1.0],
            offset: vec![0.0],
            noise: vec![1.0],
        };
        let sensors = [RawSensor::Positions(vec![1.0]), linear];
        for (level, sensor) in Level::available()
            .into_iter()
            .flat_map(|level| sensors.iter().map(move |sensor| (level, sensor)))
        {
            let mut tracks = lanes(1, 1, 3).unwrap();
            for (track, variance) in [3.0, -5.0, 3.0].into_iter().enumerate() {
                tracks.set(track, &[1.0], &[variance]);
            }
            let (mut nis, mut failures, mut singular) = ([0.0; 3], [0; 3], [false; 3]);
            let out = Outputs {
                nis: &mut nis,
                ..Outputs::default()
            };
            tracks.advance(
                0..3,
                &[step],
                sensor,
                &[5.0, 5.0, f64::NAN],
                out,
                &mut failures,
                &mut singular,
                level,
                1,
            );
            assert_eq!((failures, singular), ([0, 1, 0], [false, true, false]));
            assert!(nis[0] == 4.0 && nis[1].is_nan() && nis[2].is_nan(), "{nis:?}");
            let found = [0, 1, 2].map(|track| {
                let (mut mean, mut cov) = ([0.0], [0.0]);
                tracks.get(track, &mut mean, &mut cov);
                [mean[0], cov[0]]
            });
            assert_eq!(found, [[4.0, 0.75], [1.0, -5.0], [1.0, 3.0]]);
        }
    }
}
