//! The iterated extended filter against the cost that it minimises.

use nalgebra::{DMatrix, DVector};
use trackrs::Gaussian;
use trackrs::filter::extended::{Rule, update};
use trackrs::model::Sensor;
use trackrs::model::sensor::{PositionSensor, RangeBearing, residual};

fn prior() -> Gaussian {
    Gaussian {
        mean: DVector::from_vec(vec![60.0, 35.0, 1.0, -1.0]),
        cov: DMatrix::from_row_slice(
            4,
            4,
            &[
                400.0, 50.0, 10.0, 0.0, 50.0, 300.0, 0.0, 5.0, 10.0, 0.0, 4.0, 0.0, 0.0, 5.0, 0.0, 4.0,
            ],
        ),
    }
}

/// P⁻ times the gradient of ½‖x − x⁻‖² in P⁻ + ½‖z − h(x)‖² in R, in units of the prior's standard deviations.
fn slope(x: &DVector<f64>, radar: &RangeBearing, z: &DVector<f64>) -> f64 {
    let prior = prior();
    let h = radar.jacobian(x, None).unwrap();
    let weight = radar.noise().try_inverse().unwrap();
    let misfit = residual(radar, z, &radar.observe(x, None).unwrap());
    let gradient = x - &prior.mean - &prior.cov * h.transpose() * weight * misfit;
    gradient
        .iter()
        .zip(prior.cov.diagonal().iter())
        .map(|(g, v)| g.abs() / v.sqrt())
        .fold(0.0, f64::max)
}

#[test]
fn the_fixed_point_minimises_the_cost() {
    let radar = RangeBearing::new([0.0, 0.0], 1.0, 0.01).unwrap();
    let z = DVector::from_vec(vec![52.0, 0.9]);
    let once = update(&prior(), &radar, &z, None, Rule::Iterated(1)).unwrap();
    let often = update(&prior(), &radar, &z, None, Rule::Iterated(100)).unwrap();
    assert!(slope(&once.posterior.mean, &radar, &z) > 1e-2);
    assert!(slope(&often.posterior.mean, &radar, &z) < 1e-5);
    assert_eq!(
        (once.nis, &once.innovation, &once.innovation_cov),
        (often.nis, &often.innovation, &often.innovation_cov)
    );
    // The covariance is that of the last linearisation: the information of the prior and of H there.
    let h = radar.jacobian(&often.posterior.mean, None).unwrap();
    let weight = radar.noise().try_inverse().unwrap();
    let information = prior().cov.try_inverse().unwrap() + h.transpose() * weight * h;
    let cov = information.try_inverse().unwrap();
    assert!((&often.posterior.cov - &cov).amax() < 1e-6 * cov.amax());
}

#[test]
fn a_component_that_was_not_observed_stays_out_of_every_iteration() {
    let radar = RangeBearing::new([0.0, 0.0], 1.0, 0.01).unwrap();
    let z = DVector::from_vec(vec![52.0, f64::NAN]);
    let often = update(&prior(), &radar, &z, None, Rule::Iterated(100)).unwrap();
    let (_, range) = (often.dof, radar.observe(&often.posterior.mean, None).unwrap()[0]);
    assert!(often.dof == 1 && (range - 52.0).abs() < 0.1, "{range}");
    let nothing = DVector::from_element(2, f64::NAN);
    assert_eq!(
        update(&prior(), &radar, &nothing, None, Rule::Iterated(5))
            .unwrap()
            .posterior,
        prior()
    );
}

#[test]
fn a_linear_sensor_gives_the_kalman_update_bit_for_bit() {
    let sensor = PositionSensor::new(vec![1.0, 2.0]).unwrap();
    let z = DVector::from_vec(vec![52.0, 13.0]);
    let once = update(&prior(), &sensor, &z, None, Rule::Iterated(1)).unwrap();
    assert_eq!(once, update(&prior(), &sensor, &z, None, Rule::Iterated(20)).unwrap());
}
