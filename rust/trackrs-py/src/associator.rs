//! How reports are given to tracks.

use pyo3::prelude::*;
use trackrs::association::associator::Associator;
use trackrs::association::nearest::Nearness;
use trackrs::association::npda::{Bookkeeping, Npda, PartialCovariance};

/// An associator of the facade; what a kind does not have stands at its default.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct AssociatorItems {
    name: String,
    #[pyo3(default)]
    by: String,
    #[pyo3(default)]
    coalescence_free: bool,
    #[pyo3(default)]
    clutter_probability: Option<f64>,
    #[pyo3(default)]
    covariance: String,
    #[pyo3(default)]
    bookkeeping: String,
}

/// The associator of this name.
pub(crate) fn associator(items: &AssociatorItems) -> trackrs::Result<Associator> {
    let coalescence_free = items.coalescence_free;
    match items.name.as_str() {
        "nearest" => nearness(&items.by).map(Associator::NearestNeighbour),
        "global_nearest" => Ok(Associator::GlobalNearestNeighbour),
        "pda" => Ok(Associator::Pda),
        "jpda" => Ok(Associator::Jpda { coalescence_free }),
        "jipda" => Ok(Associator::Jipda { coalescence_free }),
        "npda" => npda(items).map(Associator::Npda),
        other => Err(trackrs::Error::invalid("associator", other, "is not known")),
    }
}

fn nearness(by: &str) -> trackrs::Result<Nearness> {
    match by {
        "likelihood" => Ok(Nearness::Likelihood),
        "distance" => Ok(Nearness::Distance),
        other => Err(trackrs::Error::invalid("by", other, "must be likelihood or distance")),
    }
}

fn npda(items: &AssociatorItems) -> trackrs::Result<Npda> {
    let covariance = match items.covariance.as_str() {
        "moment" => PartialCovariance::Moment,
        "paper" => PartialCovariance::Paper,
        "joseph" => PartialCovariance::Joseph,
        other => {
            let requirement = "must be moment, paper or joseph";
            return Err(trackrs::Error::invalid("covariance", other, requirement));
        }
    };
    let bookkeeping = match items.bookkeeping.as_str() {
        "each" => Bookkeeping::Each,
        "paper" => Bookkeeping::Paper,
        other => return Err(trackrs::Error::invalid("bookkeeping", other, "must be each or paper")),
    };
    Ok(Npda {
        clutter_probability: items.clutter_probability,
        covariance,
        bookkeeping,
    })
}
