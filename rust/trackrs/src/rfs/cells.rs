//! Cells of measurements, each distinct one once, and how partitions and trees are made of them.
//!
//! | symbol   | name here   | shape | meaning                                                           |
//! |----------|-------------|-------|-------------------------------------------------------------------|
//! | |W|      | `sizes`     |       | measurements in a cell                                            |
//! | z̄        | `means`     | m     | their mean                                                        |
//! | t        | `scatters`  |       | tr(R⁻¹ S_W)                                                       |
//! | S_W      | `matrices`  | m×m   | Σ (z − z̄)(z − z̄)ᵀ, where targets have extents                     |
//!
//! Two cells A and B into one, of whatever size, in O(1):
//! z̄ = (n_A z̄_A + n_B z̄_B) / n,  t = t_A + t_B + n_A n_B / n |L⁻¹ (z̄_A − z̄_B)|²,  S likewise with (z̄_A − z̄_B)(z̄_A − z̄_B)ᵀ.
//! Cells are told apart by the sum of 128-bit numbers that belong to their measurements: two different ones agree with
//! probability 10⁻³⁸.
//!
//! Reference: extended-target spec 4.4, 8.4; Chan, Golub, LeVeque (1983), Algorithms for computing the sample variance.

use std::collections::HashMap;

use super::view::Noise;
use crate::partition::Partition;
use crate::partition::tree::Tree;

/// Distinct cells; the first n are the single measurements.
pub(crate) struct Cells {
    dims: usize,
    pub(crate) sizes: Vec<usize>,
    means: Vec<f64>,
    whitened: Vec<f64>,
    pub(crate) scatters: Vec<f64>,
    matrices: Option<Vec<f64>>,
    keys: Vec<u128>,
    known: HashMap<u128, usize>,
}

/// A forest over cells: merge i of the tree makes cell `merged[i]`.
pub(crate) struct Forest {
    pub(crate) tree: Tree,
    pub(crate) merged: Vec<usize>,
}

/// How the measurements are divided.
pub(crate) enum Divisions {
    /// Every partition as its cells.
    Flat(Vec<Vec<usize>>),
    /// All cuts of every forest.
    Cuts(Vec<Forest>),
}

/// A number that belongs to measurement i alone: two rounds of splitmix64 (Steele, Lea, Flood 2014).
fn key(i: usize) -> u128 {
    let mix = |seed: u64| {
        let z = (seed ^ (seed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    let golden = 0x9e37_79b9_7f4a_7c15_u64;
    let [a, b] = [1, 2].map(|k| mix(golden.wrapping_mul(2 * i as u64 + k)));
    (u128::from(a) << 64) | u128::from(b)
}

impl Cells {
    /// The single measurements, m numbers each.
    pub(crate) fn singles(z: &[f64], noise: &Noise) -> Self {
        let dims = noise.cov().nrows().max(1);
        let count = z.len() / dims;
        let mut whitened = Vec::with_capacity(z.len());
        for z in z.chunks_exact(dims) {
            whitened.extend_from_slice(noise.whiten(z).as_slice());
        }
        let keys: Vec<u128> = (0..count).map(key).collect();
        Self {
            dims,
            sizes: vec![1; count],
            means: z.to_vec(),
            whitened,
            scatters: vec![0.0; count],
            matrices: None,
            known: keys.iter().enumerate().map(|(i, &key)| (key, i)).collect(),
            keys,
        }
    }

    /// The same with the scatter of every cell as a matrix.
    pub(crate) fn with_matrices(mut self) -> Self {
        self.matrices = Some(vec![0.0; self.len() * self.dims * self.dims]);
        self
    }

    /// S_W, m×m; empty without matrices.
    pub(crate) fn matrix(&self, cell: usize) -> &[f64] {
        let size = self.dims * self.dims;
        self.matrices
            .as_ref()
            .map_or(&[], |all| &all[cell * size..(cell + 1) * size])
    }

    pub(crate) fn len(&self) -> usize {
        self.sizes.len()
    }

    pub(crate) fn mean(&self, cell: usize) -> &[f64] {
        &self.means[cell * self.dims..(cell + 1) * self.dims]
    }

    /// The union of two disjoint cells.
    fn join(&mut self, a: usize, b: usize) -> usize {
        let key = self.keys[a].wrapping_add(self.keys[b]);
        if let Some(&cell) = self.known.get(&key) {
            return cell;
        }
        let cell = self.len();
        let (size_a, size_b) = (self.sizes[a] as f64, self.sizes[b] as f64);
        let total = size_a + size_b;
        let mut apart = 0.0;
        for k in 0..self.dims {
            let (i, j) = (a * self.dims + k, b * self.dims + k);
            let off = self.whitened[i] - self.whitened[j];
            apart += off * off;
            self.means
                .push((size_a * self.means[i] + size_b * self.means[j]) / total);
            self.whitened
                .push((size_a * self.whitened[i] + size_b * self.whitened[j]) / total);
        }
        self.sizes.push(self.sizes[a] + self.sizes[b]);
        self.scatters
            .push(self.scatters[a] + self.scatters[b] + size_a * size_b / total * apart);
        if let Some(matrices) = &mut self.matrices {
            let m = self.dims;
            let [first, second] = [a, b].map(|c| &self.means[c * m..(c + 1) * m]);
            for i in 0..m {
                for j in 0..m {
                    let [both, at] = [a, b].map(|c| matrices[c * m * m + i * m + j]);
                    let off = size_a * size_b / total * (first[i] - second[i]) * (first[j] - second[j]);
                    matrices.push(both + at + off);
                }
            }
        }
        self.keys.push(key);
        self.known.insert(key, cell);
        cell
    }

    /// The cells of partitions; those that no partition has and that only lead to them stay without harm.
    pub(crate) fn flat(&mut self, partitions: &[Partition]) -> Divisions {
        let mut of_members: HashMap<Vec<usize>, usize> = HashMap::new();
        let mut divisions = Vec::with_capacity(partitions.len());
        for partition in partitions {
            let cells = partition.cells().into_iter().map(|members| {
                if let Some(&cell) = of_members.get(&members) {
                    return cell;
                }
                let cell = self.gather(&members);
                of_members.insert(members, cell);
                cell
            });
            divisions.push(cells.collect());
        }
        Divisions::Flat(divisions)
    }

    /// The cell of these measurements.
    fn gather(&mut self, members: &[usize]) -> usize {
        match members {
            [] => usize::MAX,
            [only] => *only,
            _ => {
                let (left, right) = members.split_at(members.len() / 2);
                let (a, b) = (self.gather(left), self.gather(right));
                self.join(a, b)
            }
        }
    }

    /// The cells of forests.
    pub(crate) fn cuts(&mut self, trees: Vec<Tree>) -> Divisions {
        let forest = |tree: Tree| {
            let mut merged: Vec<usize> = Vec::with_capacity(tree.children.len());
            for &[a, b] in &tree.children {
                let [a, b] = [a, b].map(|node| cell_of(&tree, &merged, node));
                merged.push(self.join(a, b));
            }
            Forest { tree, merged }
        };
        Divisions::Cuts(trees.into_iter().map(forest).collect())
    }
}

fn cell_of(tree: &Tree, merged: &[usize], node: usize) -> usize {
    node.checked_sub(tree.points).map_or(node, |merge| merged[merge])
}

impl Forest {
    /// The cell of a node.
    pub(crate) fn cell(&self, node: usize) -> usize {
        cell_of(&self.tree, &self.merged, node)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sensor::PositionSensor;
    use crate::partition::Points;
    use crate::partition::tree::TreePartition;
    use crate::stats::stream::Stream;

    #[test]
    fn joined_cells_have_the_statistics_of_their_measurements() {
        let sensor = PositionSensor::new(vec![3.0; 2]).unwrap();
        let noise = Noise::of(&sensor).unwrap();
        let mut stream = Stream::new(1, 0);
        let z: Vec<f64> = (0..80).map(|_| stream.between(-50.0, 50.0)).collect();
        let mut cells = Cells::singles(&z, &noise);
        let points = Points::whitened(&z, 2, noise.cov()).unwrap();
        let trees = TreePartition {
            max_extent: Some(1e9),
            ..TreePartition::default()
        }
        .trees(&points)
        .unwrap();
        let Divisions::Cuts(forests) = cells.cuts(trees) else {
            panic!()
        };
        // Both trees end in the cell of all measurements, which is one.
        let top = forests[0].cell(forests[0].tree.roots[0]);
        assert_eq!(top, forests[1].cell(forests[1].tree.roots[0]));
        assert_eq!(cells.sizes[top], 40);
        let mean = [0, 1].map(|k| z.iter().skip(k).step_by(2).sum::<f64>() / 40.0);
        let scatter: f64 = z
            .chunks(2)
            .map(|p| (p[0] - mean[0]).powi(2) + (p[1] - mean[1]).powi(2))
            .sum();
        assert!((cells.mean(top)[0] - mean[0]).abs() < 1e-12);
        assert!((cells.scatters[top] - scatter / 9.0).abs() < 1e-10);
        // Fewer than two trees of 39 merges: what both have is there once.
        assert!(cells.len() < 40 + 78);
    }
}
