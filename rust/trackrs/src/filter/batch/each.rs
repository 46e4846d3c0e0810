//! Tracks of any filter, one after the other on each thread.

use nalgebra::{DMatrix, DVector};

use crate::error::Result;
use crate::filter::run::FilterRun;
use crate::filter::runner::Runner;
use crate::filter::sequence::{Filter, History, InitialState, Sequence};
use crate::gaussian::Gaussian;
use crate::lanes::tracks::Lanes;
use crate::lanes::work::Outputs;
use crate::model::{Motion, MotionModel, Sensor, SensorModel};
use crate::threads::{PARTS, share_out};

/// Tracks one after the other.
pub(super) struct Each<'a> {
    pub(super) filter: &'a Filter,
    pub(super) time: f64,
    pub(super) times: &'a [f64],
}

/// The parts of a run that belong to some tracks.
struct Share<'a> {
    tracks: &'a mut [Own],
    values: &'a [f64],
    means: &'a mut [f64],
    covs: &'a mut [f64],
    nis: &'a mut [f64],
}

impl Each<'_> {
    pub(super) fn run(&self, tracks: &mut [Own], values: &[f64], out: Outputs<'_>, threads: usize) -> Result<()> {
        let (n, m) = (self.filter.motion().state_dim(), self.filter.sensor().measurement_dim());
        let steps = self.times.len();
        let size = tracks.len().div_ceil(threads * PARTS).max(1);
        let mut shares = Vec::new();
        let (mut tracks, mut values) = (tracks, values);
        let Outputs {
            mut means,
            mut covs,
            mut nis,
        } = out;
        while !tracks.is_empty() {
            let count = size.min(tracks.len());
            let (first, rest) = tracks.split_at_mut(count);
            let (z, more) = values.split_at(count * steps * m);
            let wide = |part: &[f64], width: usize| if part.is_empty() { 0 } else { count * steps * width };
            let (a, b, c) = (wide(means, n), wide(covs, n * n), wide(nis, 1));
            let (x, means_rest) = means.split_at_mut(a);
            let (p, covs_rest) = covs.split_at_mut(b);
            let (e, nis_rest) = nis.split_at_mut(c);
            shares.push(Share {
                tracks: first,
                values: z,
                means: x,
                covs: p,
                nis: e,
            });
            (tracks, values, means, covs, nis) = (rest, more, means_rest, covs_rest, nis_rest);
        }
        // Models from outside the library report what they raise to the thread that called: they stay on it.
        let threads = if self.is_foreign() { 1 } else { threads };
        share_out(shares.into_iter(), threads, |mut share| self.share(&mut share))
    }

    fn is_foreign(&self) -> bool {
        let motion = matches!(self.filter.motion(), MotionModel::Custom(_));
        motion || matches!(self.filter.sensor(), SensorModel::Custom(_))
    }

    fn share(&self, share: &mut Share<'_>) -> Result<()> {
        let (n, m) = (self.filter.motion().state_dim(), self.filter.sensor().measurement_dim());
        let steps = self.times.len();
        for (track, own) in share.tracks.iter_mut().enumerate() {
            let data = Sequence {
                times: self.times,
                measurements: &share.values[track * steps * m..(track + 1) * steps * m],
                inputs: None,
                leads: None,
                first_row: 0,
            };
            let run = self.follow(own, &data)?;
            for (k, estimate) in run.filtered.iter().enumerate() {
                let row = track * steps + k;
                if let Some(to) = share.means.get_mut(row * n..(row + 1) * n) {
                    to.copy_from_slice(estimate.mean.as_slice());
                }
                if let Some(to) = share.covs.get_mut(row * n * n..(row + 1) * n * n) {
                    to.copy_from_slice(estimate.cov.as_slice());
                }
                if let Some(to) = share.nis.get_mut(row) {
                    *to = run.nis[k];
                }
            }
        }
        Ok(())
    }

    /// One track through all its measurements.
    fn follow(&self, own: &mut Own, data: &Sequence<'_>) -> Result<FilterRun> {
        let initial = InitialState {
            time: self.time,
            state: own.state.clone(),
        };
        self.filter.check(data, Some(&initial))?;
        let mut runner = Runner::new(self.filter, &initial)?;
        if let Some(factor) = &own.factor {
            runner.resume(factor)?;
        }
        let mut run = FilterRun::of(self.filter);
        run.reserve(data.times.len(), History::Filtered);
        runner.advance(data, 0..data.times.len(), History::Filtered, &mut run)?;
        if let Some(last) = run.filtered.last() {
            *own = Own {
                state: last,
                factor: runner.factor().map(<[f64]>::to_vec),
            };
        }
        Ok(run)
    }
}

/// A track that is not in lanes.
#[derive(Debug, Clone)]
pub(super) struct Own {
    pub(super) state: Gaussian,
    /// Of its covariance, where that is carried as its square root.
    pub(super) factor: Option<Vec<f64>>,
}

impl Own {
    /// Covariance row by row.
    pub(super) fn new(mean: &[f64], cov: &[f64]) -> Self {
        Self {
            state: Gaussian {
                mean: DVector::from_row_slice(mean),
                cov: DMatrix::from_row_slice(mean.len(), mean.len(), cov),
            },
            factor: None,
        }
    }

    /// A track that leaves its lane, in which another of no interest takes its place.
    pub(super) fn leaving(lanes: &mut dyn Lanes, track: usize, n: usize) -> Self {
        let (mut mean, mut cov) = (vec![0.0; n], vec![0.0; n * n]);
        lanes.get(track, &mut mean, &mut cov);
        lanes.set(track, &vec![0.0; n], DMatrix::<f64>::identity(n, n).as_slice());
        Self::new(&mean, &cov)
    }

    /// Reads it.
    pub(super) fn get(&self, mean: &mut [f64], cov: &mut [f64]) {
        mean.copy_from_slice(self.state.mean.as_slice());
        // Symmetric: columns are rows.
        cov.copy_from_slice(self.state.cov.as_slice());
    }
}
