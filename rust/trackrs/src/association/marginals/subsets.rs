//! Exact marginals of a cluster: forward and backward over subsets of the frontier.
//!
//! | symbol | name here | meaning                                                                         |
//! |--------|-----------|---------------------------------------------------------------------------------|
//! | A      | index of a layer | set of frontier members already taken, as a bit mask                       |
//! | s      | `skip`    | weight of the item taking nobody                                                |
//! | w_k    | `weight`  | weight of the item taking member k                                              |
//! | q_k    | `rest`    | weight of member k being taken by nobody                                        |
//! | X, Y   | `before`, `after` | sum of the weights of all ways to arrive at A, before and after the item        |
//! | G      | `to_come` | sum of the weights of all ways to go on from A                                  |
//!
//! Forward, item by item:
//! 1. Y[A] = s X[A] + Σ_{k∈A} w_k X[A∖k]
//! 2. where member k leaves the frontier, X[A] = q_k Y[A] + Y[A∪k] for k ∉ A, and the bit is free again.
//!
//! Backward, with G = 1 at the end:
//! 3. G[A∪k] ← G[A], G[A] ← q_k G[A], which undoes (2); then P(k taken by nobody) = Σ_{A∌k} Y[A] G[A] / Σ_A Y[A] G[A].
//! 4. P(item takes k) ∝ w_k Σ_{A∌k} X[A] G[A∪k], P(item takes nobody) ∝ s Σ_A X[A] G[A], which add up to 1.
//! 5. G[A] ← s G[A] + Σ_{k∉A} w_k G[A∪k].
//!
//! Nothing is subtracted, so every probability has the relative accuracy of the sums. Layers whose largest element leaves
//! [1e-20, 1e20] are divided by it.

use super::Method;
use super::cluster::{Cluster, Solution};
use super::frontier::{Leave, Plan, Step, Take};
use super::lattice::{dot, dot_without, drop_bit, give_back_bit, put, put_back};
use crate::interrupt::ahead;

/// X and G are at most 1e20, so what underflows is below 1e-288: below 1e-238 of a sum that is not less than this.
const LEAST_SUM: f64 = 1e-50;

/// The marginals, or `None` where the scaling of the cluster lets the sums underflow.
pub(super) fn solve(cluster: &Cluster, plan: &Plan) -> Option<Solution> {
    let scan = Scan { cluster, plan };
    let layers = scan.forward()?;
    scan.backward(&layers)
}

struct Scan<'a> {
    cluster: &'a Cluster,
    plan: &'a Plan,
}

struct Layers {
    /// Y of every step, one after the other.
    after: Vec<f64>,
    log_total: f64,
}

impl Scan<'_> {
    fn skip(&self, item: usize) -> f64 {
        if self.plan.scans_tracks {
            self.cluster.misses[item]
        } else {
            self.cluster.unused[item]
        }
    }

    fn rest(&self, slot: usize) -> f64 {
        if self.plan.scans_tracks {
            self.cluster.unused[slot]
        } else {
            self.cluster.misses[slot]
        }
    }

    fn takes(&self, step: &Step) -> &[Take] {
        &self.plan.takes[step.takes.clone()]
    }

    fn leaves(&self, step: &Step) -> &[Leave] {
        &self.plan.leaves[step.leaves.clone()]
    }

    /// X of the step after `step`, from its Y.
    fn leave(&self, step: &Step, layer: &mut [f64]) {
        let mut size = 1 << step.width;
        for leave in self.leaves(step) {
            drop_bit(&mut layer[..size], leave.bit, self.rest(leave.slot));
            if 2 << leave.bit == size {
                size /= 2; // bits fall from the highest: what is above is 0
            }
        }
    }

    fn forward(&self) -> Option<Layers> {
        let steps = &self.plan.steps;
        let widest = steps.iter().map(|step| step.width).max().unwrap_or(0);
        let mut after = vec![0.0; steps.iter().map(|step| 1_usize << step.width).sum()];
        let mut before = vec![0.0; 1 << widest];
        before[0] = 1.0;
        let (mut log_total, mut start) = (0.0, 0);
        for step in steps {
            let size = 1 << step.width;
            ahead(size);
            let layer = &mut after[start..start + size];
            put(layer, &before[..size], self.skip(step.item), self.takes(step));
            log_total += rescale(layer)?;
            before[..size].copy_from_slice(layer);
            self.leave(step, &mut before);
            start += size;
        }
        log_total += libm::log(before[0]);
        (before[0] > 0.0).then_some(Layers { after, log_total })
    }

    fn backward(&self, layers: &Layers) -> Option<Solution> {
        let steps = &self.plan.steps;
        let widest = steps.iter().map(|step| step.width).max().unwrap_or(0);
        let mut links = vec![0.0; self.cluster.links.len()];
        let mut missed = vec![0.0; self.cluster.tracks.len()];
        let mut to_come = vec![0.0; 1 << widest];
        let mut before = vec![0.0; 1 << widest];
        let mut earlier = vec![0.0; 1 << widest];
        to_come[0] = 1.0;
        let mut known = 1;
        let mut end = layers.after.len();
        for (index, step) in steps.iter().enumerate().rev() {
            let size = 1 << step.width;
            ahead(size);
            end -= size;
            let after = &layers.after[end..end + size];
            to_come[known.min(size)..size].fill(0.0);
            known = size;
            for leave in self.leaves(step).iter().rev() {
                give_back_bit(&mut to_come[..size], leave.bit, self.rest(leave.slot));
            }
            if !self.plan.scans_tracks && !self.leaves(step).is_empty() {
                let all = dot(after, &to_come[..size]);
                for leave in self.leaves(step) {
                    missed[leave.slot] = dot_without(after, &to_come[..size], leave.bit) / all;
                }
            }
            before[..size].fill(0.0);
            match index.checked_sub(1).map(|earlier| &steps[earlier]) {
                None => before[0] = 1.0,
                Some(last) => {
                    let last_size = 1 << last.width;
                    let room = &mut before[..size.max(last_size)];
                    room[..last_size].copy_from_slice(&layers.after[end - last_size..end]);
                    self.leave(last, room);
                }
            }
            let skip = self.skip(step.item);
            let skipped = skip * dot(&before[..size], &to_come[..size]);
            let target = &mut earlier[..size];
            let mut all = skipped;
            for (to, from) in target.iter_mut().zip(&to_come[..size]) {
                *to = skip * from;
            }
            for take in self.takes(step) {
                let joint = take.weight * put_back(target, &before[..size], &to_come[..size], take.bit, take.weight);
                links[take.link] = joint;
                all += joint;
            }
            if all < LEAST_SUM {
                return None;
            }
            for take in self.takes(step) {
                links[take.link] /= all;
            }
            if self.plan.scans_tracks {
                missed[step.item] = skipped / all;
            }
            rescale(target)?;
            std::mem::swap(&mut to_come, &mut earlier);
        }
        Some(Solution {
            links,
            missed,
            log_total: layers.log_total,
            method: Method::Exact,
            error_bound: Some(0.0),
        })
    }
}

fn largest(layer: &[f64]) -> f64 {
    let (chunks, last) = layer.as_chunks::<4>();
    let larger = |a: f64, b: f64| if a > b { a } else { b };
    let mut lanes = [0.0; 4];
    for chunk in chunks {
        for (lane, &value) in lanes.iter_mut().zip(chunk) {
            *lane = larger(*lane, value);
        }
    }
    lanes.iter().chain(last).copied().fold(0.0, larger)
}

/// Brings a layer back into range. Returns the logarithm of what it was divided by, `None` if nothing is left of it.
fn rescale(layer: &mut [f64]) -> Option<f64> {
    let largest = largest(layer);
    if (1e-20..=1e20).contains(&largest) {
        return Some(0.0);
    }
    if !(largest > 0.0 && largest < f64::INFINITY) {
        return None;
    }
    for value in layer {
        *value /= largest;
    }
    Some(libm::log(largest))
}
