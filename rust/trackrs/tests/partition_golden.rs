//! Partitions and outlier factors against golden files: labels exact, reals to 1e-9.

use nalgebra::DMatrix;
use serde_json::Value;
use trackrs::partition::border::BorderDensity;
use trackrs::partition::dbscan::DbscanPartition;
use trackrs::partition::density_peaks::{DensityPeakPartition, Kernel, Peaks, Scale};
use trackrs::partition::distance::{DistancePartition, Thresholds};
use trackrs::partition::lof::LocalOutlierFactor;
use trackrs::partition::spanning_tree::spanning_tree;
use trackrs::partition::tree::{Linkage, TreePartition};
use trackrs::partition::two_level::TwoLevelPartition;
use trackrs::partition::{Partition, Partitioner, Points, partitions, poisson_split};

macro_rules! golden {
    ($name:literal) => {
        serde_json::from_str::<Value>(include_str!(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../tests/data/",
            $name
        )))
        .unwrap()
    };
}

/// Infinities are texts.
fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| value.as_str().unwrap().parse().unwrap())
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(number).collect()
}

fn indices(value: &Value) -> Vec<usize> {
    serde_json::from_value(value.clone()).unwrap()
}

fn rows(value: &Value) -> (Vec<f64>, usize) {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    (rows.concat(), rows.first().map_or(2, Vec::len))
}

fn points(value: &Value) -> Points {
    let (values, dims) = rows(value);
    Points::new(&values, dims).unwrap()
}

fn assert_close(found: &[f64], expected: &[f64], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (&a, &b)) in found.iter().zip(expected).enumerate() {
        // Both are as good as zero below that.
        let close = a == b || (a - b).abs() <= 1e-9 * b.abs() || (a.abs() < 1e-300 && b.abs() < 1e-300);
        assert!(close, "{what}[{i}]: {a} is not {b}");
    }
}

/// Cells as lists of points, in an order of their own.
fn cells(partition: &Partition) -> Vec<Vec<usize>> {
    partition.cells()
}

fn expected_cells(value: &Value) -> Vec<Vec<usize>> {
    let mut cells: Vec<Vec<usize>> = value.as_array().unwrap().iter().map(indices).collect();
    for cell in &mut cells {
        cell.sort_unstable();
    }
    cells.sort();
    cells
}

#[test]
fn outlier_factors() {
    let file = golden!("et_lof.json");
    for case in file["cases"].as_array().unwrap() {
        let name = case["name"].as_str().unwrap();
        let filter = LocalOutlierFactor {
            n_neighbors: case["k"].as_u64().unwrap().try_into().unwrap(),
            include_ties: case["include_ties"].as_bool().unwrap(),
            ..LocalOutlierFactor::default()
        };
        let found = filter.explain(&points(&case["points"])).unwrap();
        assert_close(&found.k_distance, &numbers(&case["kdist"]), name);
        assert_close(&found.reachability_density, &numbers(&case["lrd"]), name);
        assert_close(&found.factors, &numbers(&case["lof"]), name);
    }
}

fn density_peaks(options: &Value) -> TwoLevelPartition {
    let count = |key: &str| options[key].as_u64().map(|n| usize::try_from(n).unwrap());
    let scale = options["dc"]
        .as_f64()
        .map_or_else(|| Scale::Percent(options["pct"].as_f64().unwrap()), Scale::Length);
    TwoLevelPartition {
        first: DensityPeakPartition {
            scale,
            kernel: match options["kernel"].as_str() {
                Some("cutoff") => Kernel::Cutoff,
                _ => Kernel::Gaussian,
            },
            peaks: match options["rule"].as_str() {
                Some("n") => Peaks::Count(count("n").unwrap()),
                Some("gap") => Peaks::Gap,
                _ => Peaks::Distance(options["kappa"].as_f64().unwrap()),
            },
            max_link: options["max_link"].as_f64(),
        },
        border: match options["border"].as_str() {
            Some("mean") => BorderDensity::Mean,
            _ => BorderDensity::Maximum,
        },
        beta: options["beta"].as_f64().unwrap_or(1.0),
    }
}

#[test]
fn density_peaks_and_two_levels() {
    let file = golden!("et_cfsfdp.json");
    for case in file["cases"].as_array().unwrap() {
        let name = case["name"].as_str().unwrap();
        let found = density_peaks(&case["options"])
            .explain(&points(&case["points"]))
            .unwrap();
        let first = &found.first;
        assert_close(&[first.d_c], &[number(&case["dc"])], name);
        assert_close(&first.rho, &numbers(&case["rho"]), name);
        assert_close(&first.delta, &numbers(&case["delta"]), name);
        assert_close(&first.gamma, &numbers(&case["gamma"]), name);
        assert_eq!(first.order, indices(&case["order"]), "{name}");
        let nearest: Vec<i64> = serde_json::from_value(case["nn"].clone()).unwrap();
        let found_nearest = first.nearest_denser.iter();
        let found_nearest: Vec<i64> = found_nearest
            .map(|nn| nn.map_or(-1, |nn| nn.try_into().unwrap()))
            .collect();
        assert_eq!(found_nearest, nearest, "{name}");
        assert_eq!(first.peaks, indices(&case["peaks"]), "{name}");
        assert_eq!(first.labels, indices(&case["lab0"]), "{name}");
        assert_eq!(found.labels, indices(&case["lab"]), "{name}");
        assert_close(&found.mean_density, &numbers(&case["rho_ave"]), name);
        let mut density = vec![f64::NEG_INFINITY; first.cells * first.cells];
        for border in &found.borders {
            let [a, b] = border.cells;
            density[a * first.cells + b] = border.density;
            density[b * first.cells + a] = border.density;
        }
        let expected: Vec<f64> = case["rho_bord"].as_array().unwrap().iter().flat_map(numbers).collect();
        assert_close(&density, &expected, name);
    }
}

#[test]
fn distance_partitions() {
    let file = golden!("et_partition.json");
    let (values, dims) = rows(&file["points"]);
    let (noise, _) = rows(&file["R"]);
    let points = Points::whitened(&values, dims, &DMatrix::from_row_slice(dims, dims, &noise)).unwrap();
    let tree = spanning_tree(&points);
    let expected = file["mst"].as_array().unwrap();
    assert_eq!(tree.len(), expected.len());
    for (edge, expected) in tree.iter().zip(expected) {
        assert_close(
            &[edge.length_squared.sqrt() / points.deviation().unwrap()],
            &[number(&expected[0])],
            "mst",
        );
        let mut ends = [&expected[1], &expected[2]].map(|end| usize::try_from(end.as_u64().unwrap()).unwrap());
        ends.sort_unstable();
        assert_eq!(edge.ends, ends);
    }
    for (thresholds, bounds, key) in [
        (Thresholds::Literature, "literature", "distance_partition_literature"),
        (
            Thresholds::Difference,
            "difference_cov",
            "distance_partition_difference",
        ),
    ] {
        let partitioner = DistancePartition {
            thresholds,
            ..DistancePartition::default()
        };
        let squared = partitioner.bounds_squared(dims).unwrap();
        assert_close(&squared.map(f64::sqrt), &numbers(&file["thresholds"][bounds]), key);
        let found: Vec<_> = partitioner.partitions(&points).unwrap().iter().map(cells).collect();
        let expected: Vec<_> = file[key].as_array().unwrap().iter().map(expected_cells).collect();
        assert_eq!(found, expected, "{key}");
    }
}

#[test]
fn dbscan_and_the_two_level_chain() {
    let file = golden!("et_partition.json");
    let points = points(&file["points"]);
    for case in file["dbscan"].as_array().unwrap() {
        let partitioner = DbscanPartition {
            eps: case["eps"].as_f64(),
            min_samples: case["min_pts"].as_u64().unwrap().try_into().unwrap(),
        };
        let labels = partitioner.labels(&points).unwrap();
        let labels: Vec<i64> = labels.iter().map(|l| l.map_or(-1, |l| l.try_into().unwrap())).collect();
        let expected: Vec<i64> = serde_json::from_value(case["labels"].clone()).unwrap();
        assert_eq!(labels, expected);
    }
    for case in file["two_level"].as_array().unwrap() {
        let filter = LocalOutlierFactor {
            n_neighbors: case["k"].as_u64().unwrap().try_into().unwrap(),
            ..LocalOutlierFactor::default()
        };
        let found = partitions(&density_peaks(&case["options"]), &points, Some(&filter)).unwrap();
        assert_eq!(cells(&found[0]), expected_cells(&case["partition"]));
    }
}

#[test]
fn how_many_targets_a_cell_comes_from() {
    for row in golden!("et_partition.json")["poisson_ml_count"].as_array().unwrap() {
        let (n, rate, expected): (usize, f64, usize) = serde_json::from_value(row.clone()).unwrap();
        let found = poisson_split::targets(n, rate);
        // The reference of the file tries no more than ten.
        assert_eq!(found.min(10), expected);
        let gain = |x: usize| n as f64 * (x as f64 * rate).ln() - x as f64 * rate;
        let better = (1..100).find(|&x| gain(x) > gain(found) + 1e-9);
        assert_eq!(better, None, "{n} of {rate}: {found}");
    }
}

#[test]
fn forests_of_the_default_filter() {
    let values = [3.0, -2.0, 18.0, 9.0, -12.0, 14.0, 95.0, 4.0, 110.0, -9.0, 700.0, -300.0];
    let trees = TreePartition {
        max_extent: Some(300.0),
        ..TreePartition::default()
    };
    assert_eq!(trees.linkages, [Linkage::Single, Linkage::Ward]);
    // The trees of the golden file of the extended-target filter.
    for tree in trees.trees(&Points::new(&values, 2).unwrap()).unwrap() {
        assert_eq!(tree.children, [[0, 1], [3, 4], [2, 6], [7, 8]]);
        assert_eq!(tree.roots, [5, 9]);
    }
}
