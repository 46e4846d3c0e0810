//! Several arrays as one, for the fusion of their measurements (U29).
//!
//! The stacked measurement is L = [ranges of array 1; ranges of array 2; …; depth], R block-diagonal: a [`RangeArray`] of
//! all hydrophones, so that fixes, starts, filters and screens work on it as they are.
//!
//! There is one depth row, the last, if any array reports the depth, with the smallest of their standard deviations. The
//! depth is measured by the target, not by the arrays: what several of them receive is one report, and one row for each
//! would count its error several times as if the rows were independent.
//!
//! Fusion array by array: rows of the stacked sensor at one time (dt = 0) with NaN in the channels of the other arrays.
//! At one linearisation point that is the stacked update itself; an extended filter linearises anew after every row.
//!
//! Reference: paper of Xi, Liu, Tao, Lu, several arrays; spec label U29.

use nalgebra::DMatrix;

use super::range_array::RangeArraySettings;
use super::sound_speed::SoundSpeed;
use super::{RangeArray, Sensor};
use crate::error::{Error, Result, require_size};

impl RangeArray {
    /// All arrays as one: their ranges in this order, then the depth, if any array reports it.
    ///
    /// The arrays have one number of dimensions, all measure ranges or all travel times, and those that use a depth profile
    /// of the sound speed use the same one throughout. A `side` that an array without depth gave is about the depth; where
    /// the stack measures the depth it has nothing left to say and is dropped. Otherwise the sides given must agree.
    pub fn stack(arrays: &[Self]) -> Result<Self> {
        let Some(first) = arrays.first() else {
            return Err(Error::invalid("arrays", "an empty list", "must have at least one"));
        };
        for (index, array) in arrays.iter().enumerate() {
            require_size(&format!("dimensions of array {index}"), first.dims(), array.dims())?;
            if array.nuisance().is_some() {
                let requirement =
                    "must have no lasting errors to be stacked: declare them in one array of all hydrophones";
                return Err(Error::invalid(&format!("array {index}"), "given", requirement));
            }
        }
        let settings = || arrays.iter().map(|array| &array.settings);
        let depth_std = settings().filter_map(|s| s.depth_std).reduce(f64::min);
        let mut hydrophones = DMatrix::zeros(arrays.iter().map(Self::channels).sum(), first.dims());
        let mut row = 0;
        for array in arrays {
            hydrophones
                .rows_mut(row, array.channels())
                .copy_from(&array.settings.hydrophones);
            row += array.channels();
        }
        let mut sides = settings()
            .filter(|s| s.depth_std.is_some() || depth_std.is_none())
            .filter_map(|s| s.side);
        let side = sides.next();
        if sides.any(|other| Some(other) != side) {
            return Err(Error::invalid(
                "side",
                "given",
                "must be the same for all stacked arrays",
            ));
        }
        let survey_std = if settings().all(|s| s.survey_std.is_empty()) {
            Vec::new()
        } else {
            let of = |array: &Self| (0..array.channels()).map(|i| array.survey_std(i)).collect::<Vec<_>>();
            arrays.iter().flat_map(of).collect()
        };
        Self::new(RangeArraySettings {
            hydrophones,
            range_std: settings().flat_map(|s| s.range_std.iter().copied()).collect(),
            survey_std,
            depth_std,
            sound_speed: stack_speeds(arrays)?,
            side,
        })
    }
}

fn stack_speeds(arrays: &[RangeArray]) -> Result<Option<SoundSpeed>> {
    let speeds: Vec<&SoundSpeed> = arrays.iter().filter_map(|a| a.settings.sound_speed.as_ref()).collect();
    let Some(&first) = speeds.first() else {
        return Ok(None);
    };
    let refuse = |value: &str, requirement: &str| Err(Error::invalid("sound_speed", value, requirement));
    if speeds.len() < arrays.len() {
        return refuse(
            "given for some of the arrays",
            "stacked arrays must all measure ranges or all travel times",
        );
    }
    if speeds.iter().all(|&speed| speed == first) && !matches!(first, SoundSpeed::PerChannel(_)) {
        return Ok(Some(first.clone()));
    }
    let mut all = Vec::new();
    for (array, speed) in arrays.iter().zip(speeds) {
        match speed {
            SoundSpeed::Uniform(c) => all.extend(std::iter::repeat_n(*c, array.channels())),
            SoundSpeed::PerChannel(each) => all.extend_from_slice(each),
            SoundSpeed::Profile(_) => {
                return refuse(
                    "a depth profile of some of the arrays",
                    "stacked arrays must share the profile",
                );
            }
        }
    }
    Ok(Some(SoundSpeed::PerChannel(all)))
}

#[cfg(test)]
mod tests {
    use super::super::Side;
    use super::super::sound_speed::SpeedProfile;
    use super::*;
    use nalgebra::DVector;

    fn array(offset: f64, depth_std: Option<f64>) -> RangeArraySettings {
        let rows = [0.0, 0.0, 250.0, 1000.0, 0.0, 252.0, 500.0, 866.0, 248.0];
        RangeArraySettings {
            hydrophones: DMatrix::from_row_slice(3, 3, &rows).add_scalar(offset),
            range_std: vec![1.0 + offset],
            survey_std: Vec::new(),
            depth_std,
            sound_speed: None,
            side: None,
        }
    }

    fn made(settings: RangeArraySettings) -> RangeArray {
        RangeArray::new(settings).unwrap()
    }

    #[test]
    fn ranges_stand_in_order_and_the_depth_comes_last_once() {
        let (a, b) = (made(array(0.0, Some(0.5))), made(array(10.0, Some(0.3))));
        let both = RangeArray::stack(&[a.clone(), b.clone()]).unwrap();
        let state = DVector::from_vec(vec![100.0, 200.0, 60.0]);
        let (x, y) = (a.observe(&state, None).unwrap(), b.observe(&state, None).unwrap());
        let expected: Vec<f64> = x
            .iter()
            .take(3)
            .chain(y.iter().take(3))
            .copied()
            .chain([60.0])
            .collect();
        assert_eq!(both.observe(&state, None).unwrap(), DVector::from_vec(expected));
        let variances = [1.0, 1.0, 1.0, 121.0, 121.0, 121.0, 0.3 * 0.3];
        assert_eq!(both.noise().diagonal().as_slice(), variances);
        assert_eq!(both.labels().last().map(String::as_str), Some("depth"));
        let same = RangeArray::stack(std::slice::from_ref(&b)).unwrap();
        assert_eq!(same, b);
    }

    #[test]
    fn survey_of_one_array_does_not_touch_the_other() {
        let surveyed = RangeArraySettings {
            survey_std: vec![2.0, 0.0, 2.0],
            ..array(0.0, None)
        };
        let both = RangeArray::stack(&[made(surveyed), made(array(10.0, None))]).unwrap();
        let variances = [5.0, 1.0, 5.0, 121.0, 121.0, 121.0];
        for (found, expected) in both.noise().diagonal().iter().zip(variances) {
            assert!((found - expected).abs() < 1e-12 * expected);
        }
    }

    #[test]
    fn speeds_become_one_rule() {
        let with = |speed: Option<SoundSpeed>| {
            made(RangeArraySettings {
                sound_speed: speed,
                ..array(0.0, None)
            })
        };
        let uniform = |c| with(Some(SoundSpeed::Uniform(c)));
        let profile = |c| {
            with(Some(SoundSpeed::Profile(
                SpeedProfile::new(vec![0.0, 300.0], vec![1520.0, c]).unwrap(),
            )))
        };
        let each = |arrays: &[RangeArray]| RangeArray::stack(arrays).map(|a| a.settings.sound_speed);
        assert_eq!(
            each(&[uniform(1500.0), uniform(1500.0)]),
            Ok(Some(SoundSpeed::Uniform(1500.0)))
        );
        let mixed = [1500.0, 1500.0, 1500.0, 1490.0, 1490.0, 1490.0].to_vec();
        assert_eq!(
            each(&[uniform(1500.0), uniform(1490.0)]),
            Ok(Some(SoundSpeed::PerChannel(mixed)))
        );
        assert_eq!(
            each(&[profile(1490.0), profile(1490.0)]),
            Ok(profile(1490.0).settings.sound_speed)
        );
        assert!(each(&[profile(1490.0), profile(1480.0)]).is_err());
        assert!(each(&[profile(1490.0), uniform(1480.0)]).is_err());
        let error = each(&[with(None), uniform(1480.0)]).unwrap_err().to_string();
        assert!(error.contains("sound_speed"), "{error}");
    }

    #[test]
    fn a_side_stays_where_it_means_the_same() {
        let with = |side, depth_std| {
            made(RangeArraySettings {
                side,
                ..array(0.0, depth_std)
            })
        };
        let side = |arrays: &[RangeArray]| RangeArray::stack(arrays).map(|a| a.settings.side);
        let above = Some(Side::Above);
        assert_eq!(side(&[with(above, None), with(None, None)]), Ok(above));
        assert_eq!(side(&[with(above, None), with(None, Some(0.3))]), Ok(None));
        assert_eq!(
            side(&[with(above, Some(0.3)), with(Some(Side::Below), None)]),
            Ok(above)
        );
        assert!(side(&[with(above, None), with(Some(Side::Below), None)]).is_err());
    }

    #[test]
    fn what_does_not_fit_is_named() {
        assert!(RangeArray::stack(&[]).is_err());
        let flat = made(RangeArraySettings {
            hydrophones: DMatrix::identity(3, 2),
            ..array(0.0, None)
        });
        let error = RangeArray::stack(&[made(array(0.0, None)), flat]).unwrap_err();
        assert_eq!(error, Error::dimension("dimensions of array 1", 3, 2));
    }
}
