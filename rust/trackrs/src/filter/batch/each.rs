//! Tracks of any filter, some on each thread.

use nalgebra::DVector;

use crate::error::Result;
use crate::filter::sequence::{Filter, History, InitialState};
use crate::gaussian::Gaussian;
use crate::lanes::block::LANES;
use crate::lanes::work::Outputs;
use crate::model::{Motion, MotionModel, Sensor, SensorModel};

/// Tracks one after the other.
pub(super) struct Each<'a> {
    pub(super) filter: &'a Filter,
    pub(super) time: f64,
    pub(super) times: &'a [f64],
}

/// The parts of a run that belong to some tracks.
struct Share<'a> {
    states: &'a mut [Gaussian],
    values: &'a [f64],
    means: &'a mut [f64],
    covs: &'a mut [f64],
    nis: &'a mut [f64],
}

impl Each<'_> {
    pub(super) fn run(&self, states: &mut [Gaussian], values: &[f64], out: Outputs<'_>, threads: usize) -> Result<()> {
        let (n, m) = (self.filter.motion().state_dim(), self.filter.sensor().measurement_dim());
        let steps = self.times.len();
        let size = states.len().div_ceil(threads.max(1)).max(1).next_multiple_of(LANES);
        let mut shares = Vec::new();
        let (mut states, mut values) = (states, values);
        let Outputs {
            mut means,
            mut covs,
            mut nis,
        } = out;
        while !states.is_empty() {
            let count = size.min(states.len());
            let (first, rest) = states.split_at_mut(count);
            let (z, more) = values.split_at(count * steps * m);
            let wide = |part: &[f64], width: usize| if part.is_empty() { 0 } else { count * steps * width };
            let (a, b, c) = (wide(means, n), wide(covs, n * n), wide(nis, 1));
            let (x, means_rest) = means.split_at_mut(a);
            let (p, covs_rest) = covs.split_at_mut(b);
            let (e, nis_rest) = nis.split_at_mut(c);
            shares.push(Share {
                states: first,
                values: z,
                means: x,
                covs: p,
                nis: e,
            });
            (states, values, means, covs, nis) = (rest, more, means_rest, covs_rest, nis_rest);
        }
        // Models from outside the library report what they raise to the thread that called: they stay on it.
        if threads <= 1 || self.is_foreign() {
            return shares.into_iter().try_for_each(|mut share| self.share(&mut share));
        }
        std::thread::scope(|scope| {
            let workers: Vec<_> = shares
                .into_iter()
                .map(|mut share| scope.spawn(move || self.share(&mut share)))
                .collect();
            workers
                .into_iter()
                .try_for_each(|worker| worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
        })
    }

    fn is_foreign(&self) -> bool {
        let motion = matches!(self.filter.motion(), MotionModel::Custom(_));
        motion || matches!(self.filter.sensor(), SensorModel::Custom(_))
    }

    fn share(&self, share: &mut Share<'_>) -> Result<()> {
        let (n, m) = (self.filter.motion().state_dim(), self.filter.sensor().measurement_dim());
        let steps = self.times.len();
        for (track, state) in share.states.iter_mut().enumerate() {
            let rows = share.values[track * steps * m..(track + 1) * steps * m].chunks_exact(m);
            let values: Vec<DVector<f64>> = rows.map(DVector::from_row_slice).collect();
            let initial = InitialState {
                time: self.time,
                state: state.clone(),
            };
            let run = self
                .filter
                .run(self.times, &values, Some(&initial), None, History::Filtered)?;
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
            if let Some(last) = run.filtered.last() {
                *state = last;
            }
        }
        Ok(())
    }
}
