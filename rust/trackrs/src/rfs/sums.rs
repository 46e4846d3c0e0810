//! Sums over partitions: how likely each cell is, if partitions weigh as the product of their cells.
//!
//! | symbol | name here      | meaning                                                              |
//! |--------|----------------|----------------------------------------------------------------------|
//! | d_W    | `log_weights`  | weight of a cell (its logarithm)                                     |
//! | q_W    | `log_shares`   | probability that W is a cell (its logarithm)                         |
//! | Z      | `log_evidence` | mean over the partitions, or over the trees, of the sum of products  |
//!
//! Partitions: ω_p ∝ Π d_W;  q_W = Σ_{p has W} ω_p.
//! All cuts of a tree, though there may be exponentially many, in O(nodes):
//!   up:    Z(leaf) = d_leaf;  Z(v) = d_v + Π_children Z(c)
//!   down:  R(root) = 1;  q(v) = R(v) d_v / Z(v);  R(child) = R(v) Π Z(c) / Z(v)
//! Several trees are a mixture with weights ∝ Π_roots Z. If every weight is zero, all partitions weigh the same.
//!
//! Reference: extended-target spec 4.3, 4.4, 8.2.

use super::cells::{Divisions, Forest};

/// What a sum over partitions gives.
pub(crate) struct PartitionSum {
    pub(crate) log_shares: Vec<f64>,
    pub(crate) log_evidence: f64,
}

/// ln(eᵃ + eᵇ).
pub(crate) fn log_add(a: f64, b: f64) -> f64 {
    let (high, low) = if a > b { (a, b) } else { (b, a) };
    if low == f64::NEG_INFINITY {
        return high;
    }
    high + libm::log1p(libm::exp(low - high))
}

/// ln Σ eˣ; −∞ of nothing.
pub(crate) fn log_sum(values: &[f64]) -> f64 {
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if high == f64::NEG_INFINITY {
        return high;
    }
    high + libm::log(values.iter().map(|x| libm::exp(x - high)).sum())
}

/// ln of the shares of alternatives of these weights.
fn log_normalised(log_weights: &[f64]) -> Vec<f64> {
    let total = log_sum(log_weights);
    if total == f64::NEG_INFINITY {
        return vec![-libm::log(log_weights.len() as f64); log_weights.len()];
    }
    log_weights.iter().map(|x| x - total).collect()
}

impl Divisions {
    /// The sum over all of them.
    pub(crate) fn sum(&self, log_weights: &[f64]) -> PartitionSum {
        let mut log_shares = vec![f64::NEG_INFINITY; log_weights.len()];
        let totals: Vec<Vec<f64>> = match self {
            Self::Flat(_) => Vec::new(),
            Self::Cuts(forests) => forests.iter().map(|forest| forest.totals(log_weights)).collect(),
        };
        let products: Vec<f64> = match self {
            Self::Flat(partitions) => {
                let product = |cells: &Vec<usize>| cells.iter().map(|&cell| log_weights[cell]).sum();
                partitions.iter().map(product).collect()
            }
            Self::Cuts(forests) => {
                let up =
                    |(forest, totals): (&Forest, &Vec<f64>)| forest.tree.roots.iter().map(|&root| totals[root]).sum();
                forests.iter().zip(&totals).map(up).collect()
            }
        };
        let omega = log_normalised(&products);
        match self {
            Self::Flat(partitions) => {
                for (cells, omega) in partitions.iter().zip(&omega) {
                    for &cell in cells {
                        log_shares[cell] = log_add(log_shares[cell], *omega);
                    }
                }
            }
            Self::Cuts(forests) => {
                for ((forest, totals), omega) in forests.iter().zip(&totals).zip(&omega) {
                    forest.share(log_weights, totals, *omega, &mut log_shares);
                }
            }
        }
        let log_evidence = log_sum(&products) - libm::log(products.len() as f64);
        PartitionSum {
            log_shares,
            log_evidence,
        }
    }
}

impl Forest {
    fn nodes(&self) -> usize {
        self.tree.points + self.tree.children.len()
    }

    /// ln Z of every node.
    fn totals(&self, log_weights: &[f64]) -> Vec<f64> {
        let mut totals = Vec::with_capacity(self.nodes());
        totals.extend_from_slice(&log_weights[..self.tree.points]);
        for (&[a, b], &cell) in self.tree.children.iter().zip(&self.merged) {
            totals.push(log_add(log_weights[cell], totals[a] + totals[b]));
        }
        totals
    }

    /// Adds the shares of the forest's nodes, `omega` times.
    fn share(&self, log_weights: &[f64], totals: &[f64], omega: f64, log_shares: &mut [f64]) {
        let mut reach = vec![f64::NEG_INFINITY; self.nodes()];
        self.tree.roots.iter().for_each(|&root| reach[root] = omega);
        for node in (0..self.nodes()).rev() {
            let cell = self.cell(node);
            // A node without weight is as good as none; a leaf without weight is the only cut of its own.
            let merge = node.checked_sub(self.tree.points);
            let (own, below) = if totals[node] == f64::NEG_INFINITY {
                let leaf = merge.is_none();
                (if leaf { 0.0 } else { f64::NEG_INFINITY }, 0.0)
            } else {
                let below = merge.map_or(f64::NEG_INFINITY, |merge| {
                    let [a, b] = self.tree.children[merge];
                    totals[a] + totals[b] - totals[node]
                });
                (log_weights[cell] - totals[node], below)
            };
            log_shares[cell] = log_add(log_shares[cell], reach[node] + own);
            if let Some(merge) = merge {
                self.tree.children[merge]
                    .iter()
                    .for_each(|&child| reach[child] = reach[node] + below);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::partition::tree::Tree;
    use crate::stats::stream::Stream;

    /// A tree over n points whose merges join random nodes.
    fn random_forest(n: usize, merges: usize, stream: &mut Stream) -> Forest {
        let mut free: Vec<usize> = (0..n).collect();
        let mut children = Vec::new();
        for i in 0..merges {
            let mut take = |free: &mut Vec<usize>| {
                let all: Vec<usize> = (0..free.len()).collect();
                free.swap_remove(*stream.choice(&all).unwrap())
            };
            let (a, b) = (take(&mut free), take(&mut free));
            children.push([a.min(b), a.max(b)]);
            free.push(n + i);
        }
        free.sort_unstable();
        Forest {
            merged: (n..n + merges).collect(),
            tree: Tree {
                points: n,
                heights: vec![1.0; merges],
                children,
                roots: free,
            },
        }
    }

    /// Every cut below a node, as the cells in it.
    fn cuts(forest: &Forest, node: usize) -> Vec<Vec<usize>> {
        let mut out = vec![vec![forest.cell(node)]];
        if let Some(merge) = node.checked_sub(forest.tree.points) {
            let [left, right] = forest.tree.children[merge].map(|child| cuts(forest, child));
            for a in &left {
                for b in &right {
                    out.push([a.clone(), b.clone()].concat());
                }
            }
        }
        out
    }

    #[test]
    fn the_sum_over_a_tree_is_the_sum_over_its_cuts() {
        let mut stream = Stream::new(5, 0);
        for case in 0..400 {
            let n = 1 + case % 8;
            let merges = *stream.choice(&(0..n).collect::<Vec<_>>()).unwrap();
            let forest = random_forest(n, merges, &mut stream);
            let weights: Vec<f64> = (0..n + merges).map(|_| 6.0 * stream.normal()).collect();
            let mut all: Vec<Vec<usize>> = vec![vec![]];
            for &root in &forest.tree.roots {
                let below = cuts(&forest, root);
                all = all
                    .iter()
                    .flat_map(|head| below.iter().map(move |tail| [head.clone(), tail.clone()].concat()))
                    .collect();
            }
            let flat = Divisions::Flat(all.clone()).sum(&weights);
            let tree = Divisions::Cuts(vec![forest]).sum(&weights);
            for (a, b) in flat.log_shares.iter().zip(&tree.log_shares) {
                assert!((a.exp() - b.exp()).abs() < 1e-13, "{a} {b}");
            }
            let total = flat.log_evidence + (all.len() as f64).ln();
            assert!((total - tree.log_evidence).abs() < 1e-12 * total.abs().max(1.0));
        }
    }

    #[test]
    fn weights_of_zero_leave_equal_partitions() {
        let none = vec![f64::NEG_INFINITY; 3];
        let sum = Divisions::Flat(vec![vec![0, 1], vec![2]]).sum(&none);
        assert!(sum.log_shares.iter().all(|share| (share.exp() - 0.5).abs() < 1e-15));
        let forest = random_forest(2, 1, &mut Stream::new(1, 0));
        let sum = Divisions::Cuts(vec![forest]).sum(&none);
        assert!(sum.log_shares.iter().all(|share| !share.is_nan()));
    }
}
