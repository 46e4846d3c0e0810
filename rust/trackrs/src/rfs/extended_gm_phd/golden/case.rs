//! The vectors of the independent implementation as what they are.

use nalgebra::{DMatrix, DVector};
use serde_json::Value;

use super::super::*;
use crate::gaussian::Gaussian;
use crate::partition::tree::TreePartition;
use crate::rfs::rate::Rate;

pub(super) fn cases() -> Vec<Value> {
    let text = include_str!("../../../../../../tests/data/et_gm_phd.json");
    let mut file: Value = serde_json::from_str(text).unwrap();
    let Value::Array(cases) = file["cases"].take() else {
        panic!("no cases")
    };
    cases
}

pub(super) fn number(value: &Value) -> f64 {
    match value.as_str() {
        Some("-inf") => f64::NEG_INFINITY,
        Some(other) => panic!("{other}"),
        None => value.as_f64().unwrap(),
    }
}

pub(super) fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(number).collect()
}

pub(super) fn indices(value: &Value) -> Vec<usize> {
    let index = |v: &Value| usize::try_from(v.as_u64().unwrap()).unwrap();
    value.as_array().unwrap().iter().map(index).collect()
}

pub(super) fn gaussian(mean: &Value, cov: &Value) -> Gaussian {
    let rows: Vec<f64> = cov.as_array().unwrap().iter().flat_map(numbers).collect();
    let mean = DVector::from_vec(numbers(mean));
    Gaussian {
        cov: DMatrix::from_row_slice(mean.len(), mean.len(), &rows),
        mean,
    }
}

pub(super) fn mixture(value: &Value) -> Vec<Component> {
    let component = |(i, &weight): (usize, &f64)| Component {
        weight,
        state: gaussian(&value["m"][i], &value["P"][i]),
        rate: Rate {
            shape: number(&value["a"][i]),
            inverse_scale: number(&value["b"][i]),
        },
        extent: None,
        label: i as u64,
        rooted: false,
    };
    numbers(&value["w"]).iter().enumerate().map(component).collect()
}

/// The model of a case; "const" has one rate for all, whatever the components carry.
pub(super) struct Case {
    pub(super) value: Value,
    pub(super) update: ExtendedUpdate,
    pub(super) constant: Option<f64>,
}

impl Case {
    pub(super) fn all() -> Vec<Self> {
        let case = |value: Value| {
            let rates = match value["gamma_mode"].as_str().unwrap() {
                "gamma" => RateModel::Learnt {
                    forgetting: number(&value["eta"]),
                    floor: number(&value["gamma_min"]),
                },
                _ => RateModel::Known,
            };
            let tree = TreePartition {
                max_extent: Some(number(&value["group_update"]["dmax"])),
                ..TreePartition::default()
            };
            Self {
                constant: (value["gamma_mode"] == "const").then(|| number(&value["gamma"])),
                update: ExtendedUpdate {
                    rates,
                    partition: PartitionModel::Tree(tree),
                    clutter_filter: None,
                    superposition: true,
                    prune: number(&value["prune"]),
                    extent: None,
                },
                value,
            }
        };
        cases().into_iter().map(case).collect()
    }

    pub(super) fn predicted(&self) -> Vec<Component> {
        let mut predicted = mixture(&self.value["predicted"]);
        if let Some(rate) = self.constant {
            for component in &mut predicted {
                component.rate = Rate::with_mean(rate, 10.0);
            }
        }
        predicted
    }

    pub(super) fn measurements(&self) -> Vec<f64> {
        self.value["Z"].as_array().unwrap().iter().flat_map(numbers).collect()
    }

    pub(super) fn log_clutter(&self) -> f64 {
        number(&self.value["log_kappa"])
    }

    /// Same components in whatever order.
    pub(super) fn assert_mixture(&self, found: &[Component], expected: &Value, what: &str) {
        let mut left = found.to_vec();
        let expected = mixture(expected);
        assert_eq!(found.len(), expected.len(), "{what}");
        for component in &expected {
            let distance = |other: &Component| {
                let mean = (&other.state.mean - &component.state.mean).amax() / component.state.mean.amax();
                let cov = (&other.state.cov - &component.state.cov).amax() / component.state.cov.amax();
                let weight = (other.weight - component.weight).abs() / component.weight.max(1.0);
                let rate = if self.constant.is_some() {
                    0.0
                } else {
                    let shape = (other.rate.shape / component.rate.shape - 1.0).abs();
                    shape.max((other.rate.inverse_scale / component.rate.inverse_scale - 1.0).abs())
                };
                mean.max(cov).max(weight).max(rate)
            };
            let nearest = (0..left.len())
                .min_by(|&a, &b| distance(&left[a]).total_cmp(&distance(&left[b])))
                .unwrap();
            assert!(
                distance(&left[nearest]) < 1e-9,
                "{what}: {component:?} is not {:?}",
                left[nearest]
            );
            left.swap_remove(nearest);
        }
    }
}
