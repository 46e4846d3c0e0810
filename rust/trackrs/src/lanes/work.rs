//! Steps of many tracks, one register of them after the other.
//!
//! A step of one register is a long chain in which every result waits for the one before: two divisions, two substitutions,
//! the Joseph form. Blocks are therefore taken in pairs, step by step, so that the processor has a second chain to
//! work at; between its steps a block stands in the nearest cache.

use pulp::{Simd, WithSimd};

use super::block::{Block, LANES, Lane};
use super::condition::{Condition, variances};
use super::kinematic::{Found, Step, predict};
use super::transport::{Spot, load, scatter, scatter_symmetric, store};

/// Blocks that are taken together.
pub(super) const TOGETHER: usize = 2;

/// What the filter gives for every track and step; tracks first, then steps. Parts that are not wanted are empty.
#[derive(Debug, Default)]
pub struct Outputs<'a> {
    /// N each.
    pub means: &'a mut [f64],
    /// N×N each.
    pub covs: &'a mut [f64],
    /// One each; NaN where nothing was observed.
    pub nis: &'a mut [f64],
}

/// What the tracks are measured by.
pub(super) trait Measured<const N: usize, const PN: usize>: Sync {
    /// How many components a measurement has.
    fn components(&self) -> usize;

    /// Takes in the measurements of some tracks at one step; those of a call stand track after track, step after step.
    fn update<S: Simd>(
        &self,
        simd: S,
        x: &mut [S::f64s; N],
        p: &mut [S::f64s; PN],
        values: &[f64],
        spot: Spot,
    ) -> Found<S>;
}

/// Some steps of some blocks.
pub(super) struct Work<'a, M, const D: usize, const K: usize, const N: usize, const PN: usize> {
    pub(super) blocks: &'a mut [Block<N, PN>],
    /// Tracks in these blocks; the rest of the last one fills it up.
    pub(super) tracks: usize,
    pub(super) steps: &'a [Step<D>],
    pub(super) sensor: &'a M,
    /// Measurements, track after track, step after step.
    pub(super) values: &'a [f64],
    pub(super) out: Outputs<'a>,
    /// Per track: how often it kept its prediction because of a pivot.
    pub(super) failures: &'a mut [u64],
    /// Per track: whether its covariance came close to being singular.
    pub(super) singular: &'a mut [bool],
}

impl<M: Measured<N, PN>, const D: usize, const K: usize, const N: usize, const PN: usize> WithSimd
    for Work<'_, M, D, K, N, PN>
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            blocks,
            tracks,
            steps,
            sensor,
            values,
            out,
            failures,
            singular,
        } = self;
        let count = steps.len();
        let width = S::F64_LANES;
        for (pair, blocks) in blocks.chunks_mut(TOGETHER).enumerate() {
            let begin = pair * TOGETHER * LANES;
            let (mut failed, mut marked) = ([Lane([0.0; LANES]); TOGETHER], [Lane([0.0; LANES]); TOGETHER]);
            // Where the blocks stood: a copy is made when a step is taken that is not the only one, or when it is needed.
            let mut before: [Option<Block<N, PN>>; TOGETHER] = [None; TOGETHER];
            for (t, step) in steps.iter().enumerate() {
                for (b, block) in blocks.iter_mut().enumerate() {
                    for register in 0..LANES / width {
                        let first = begin + b * LANES + register * width;
                        if first >= tracks {
                            break;
                        }
                        let used = width.min(tracks - first);
                        let spot = Spot {
                            first,
                            used,
                            steps: count,
                            t,
                        };
                        let mut x = load::<S, N>(simd, &block.mean, register);
                        let mut p = load::<S, PN>(simd, &block.cov, register);
                        let mut condition = Condition::<S> {
                            det: simd.add_f64s(S::as_simd_f64s(&block.det.0).0[register], simd.splat_f64s(step.det)),
                            singular: S::as_simd_f64s(&marked[b].0).0[register],
                        };
                        predict::<S, D, K, N, PN>(simd, &mut x, &mut p, step);
                        let scale = variances::<S, N, PN>(simd, &p);
                        condition.check::<N, PN>(simd, &p, scale);
                        let found = sensor.update(simd, &mut x, &mut p, values, spot);
                        condition.det = simd.mul_f64s(condition.det, found.shrunk);
                        condition.check::<N, PN>(simd, &p, scale);
                        if before[b].is_none() && (count > 1 || simd.reduce_max_f64s(condition.singular) > 0.0) {
                            before[b] = Some(*block);
                        }
                        store::<S, N>(&mut block.mean, &x, register);
                        store::<S, PN>(&mut block.cov, &p, register);
                        S::as_mut_simd_f64s(&mut block.det.0).0[register] = condition.det;
                        S::as_mut_simd_f64s(&mut marked[b].0).0[register] = condition.singular;
                        let failures = &mut S::as_mut_simd_f64s(&mut failed[b].0).0[register];
                        *failures = simd.add_f64s(*failures, found.failed);
                        if !out.means.is_empty() {
                            scatter::<S, N>(out.means, &x, spot);
                        }
                        if !out.covs.is_empty() {
                            scatter_symmetric::<S, N, PN>(out.covs, &p, spot);
                        }
                        if !out.nis.is_empty() {
                            scatter::<S, 1>(out.nis, &[found.nis], spot);
                        }
                    }
                }
            }
            // Mostly there is nothing to tell, which is seen at once.
            let bits = |all: &[Lane]| all.iter().flat_map(|lane| lane.0).fold(0, |bits, x| bits | x.to_bits());
            if bits(&marked) | bits(&failed) == 0 {
                continue;
            }
            let marked = marked.iter().flat_map(|lane| &lane.0);
            for (track, (singular, &mark)) in singular[begin..].iter_mut().zip(marked).enumerate() {
                let (b, lane) = (track / LANES, track % LANES);
                if mark > 0.0
                    && let Some(before) = &before[b]
                {
                    *singular = true;
                    blocks[b].put_back(lane, before);
                }
            }
            for (count, &lane) in failures[begin..].iter_mut().zip(failed.iter().flat_map(|lane| &lane.0)) {
                // A whole number of steps.
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                if lane != 0.0 {
                    *count += lane as u64;
                }
            }
        }
    }
}
