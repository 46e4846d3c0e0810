//! Scores.

use nalgebra::DVector;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use trackrs::Track;
use trackrs::metric::consistency::{self, ChiSquareTests};
use trackrs::metric::evaluate::{self as core, FrameScore, Scoring, TargetScore, TruthPath};
use trackrs::metric::{gospa as gospa_, innovation, ospa as ospa_, whiteness as whiteness_};

use crate::array;
use crate::error::{compute_long, count, to_python};

/// Total, localisation, cardinality.
#[pyfunction]
pub(crate) fn ospa(
    py: Python<'_>,
    x: &Bound<'_, PyArray2<f64>>,
    y: &Bound<'_, PyArray2<f64>>,
    cutoff: f64,
    order: f64,
) -> PyResult<(f64, f64, f64)> {
    let (x, y) = (array::copied(x, "x")?, array::copied(y, "y")?);
    let out = compute_long(py, || ospa_::ospa(&x, &y, cutoff, order))?;
    Ok((out.total, out.localisation, out.cardinality))
}

/// Total, localisation, missed, false; and the pairs, 24 bytes each, as two integers and a number.
type Gospa<'py> = (f64, f64, f64, f64, Bound<'py, PyBytes>);

#[pyfunction]
#[pyo3(signature = (truth, estimates, cutoff, order, alpha, extents = None))]
pub(crate) fn gospa<'py>(
    py: Python<'py>,
    truth: &Bound<'py, PyArray2<f64>>,
    estimates: &Bound<'py, PyArray2<f64>>,
    cutoff: f64,
    order: f64,
    alpha: f64,
    extents: Option<(PyReadonlyArray3<'py, f64>, PyReadonlyArray3<'py, f64>)>,
) -> PyResult<Gospa<'py>> {
    let (x, y) = (array::copied(truth, "truth")?, array::copied(estimates, "estimates")?);
    let covs = |covs: &PyReadonlyArray3<'_, f64>| array::matrices(covs, "extents");
    let extents = extents
        .map(|(of_x, of_y)| Ok::<_, PyErr>([covs(&of_x)?, covs(&of_y)?]))
        .transpose()?;
    let of = |centres, extents| gospa_::Ellipses { centres, extents };
    let out = compute_long(py, || match &extents {
        None => gospa_::gospa(&x, &y, cutoff, order, alpha),
        Some([of_x, of_y]) => gospa_::gospa_of_extents(of(&x, of_x), of(&y, of_y), cutoff, order, alpha),
    })?;
    let mut pairs = Vec::with_capacity(24 * out.pairs.len());
    for pair in &out.pairs {
        for index in [pair.truth, pair.estimate] {
            pairs.extend_from_slice(&(index as u64).to_le_bytes());
        }
        pairs.extend_from_slice(&pair.distance.to_le_bytes());
    }
    let pairs = PyBytes::new(py, &pairs);
    Ok((out.total, out.localisation, out.missed, out.false_tracks, pairs))
}

/// One entry per row.
#[derive(IntoPyObject)]
pub(crate) struct Tests<'py> {
    statistics: Bound<'py, PyArray1<f64>>,
    dof: Bound<'py, PyArray1<i64>>,
    p_values: Bound<'py, PyArray1<f64>>,
}

impl<'py> Tests<'py> {
    fn new(py: Python<'py>, tests: ChiSquareTests) -> Self {
        let dof = tests.dof.iter().map(|&d| i64::try_from(d).unwrap_or(i64::MAX));
        Self {
            dof: PyArray1::from_iter(py, dof),
            statistics: PyArray1::from_vec(py, tests.statistics),
            p_values: PyArray1::from_vec(py, tests.p_values),
        }
    }
}

#[pyfunction]
pub(crate) fn nees<'py>(
    py: Python<'py>,
    errors: PyReadonlyArray2<'py, f64>,
    covs: PyReadonlyArray3<'py, f64>,
) -> PyResult<Tests<'py>> {
    let matrix = array::matrix(&errors, "errors")?;
    let covs = array::matrices(&covs, "covs")?;
    let out = compute_long(py, || consistency::nees(&matrix, &covs))?;
    Ok(Tests::new(py, out))
}

#[pyfunction]
pub(crate) fn nis<'py>(
    py: Python<'py>,
    innovations: PyReadonlyArray2<'py, f64>,
    covs: PyReadonlyArray3<'py, f64>,
) -> PyResult<Tests<'py>> {
    let rows = array::rows(&innovations, "innovations")?;
    let covs = array::matrices(&covs, "covs")?;
    let out = compute_long(py, || innovation::nis(&rows, &covs))?;
    Ok(Tests::new(py, out))
}

/// Sums of `statistics`; without a window over all rows so far.
#[pyfunction]
#[pyo3(signature = (statistics, dof, restarts, window=None))]
pub(crate) fn cumulative<'py>(
    py: Python<'py>,
    statistics: PyReadonlyArray1<'py, f64>,
    dof: PyReadonlyArray1<'py, i64>,
    restarts: Vec<usize>,
    window: Option<i64>,
) -> PyResult<Tests<'py>> {
    let statistics = array::vector(&statistics, "statistics")?;
    let dof: Vec<i64> = dof.as_array().iter().copied().collect();
    let out = compute_long(py, || {
        let dof = dof.iter().map(|&d| count("dof", d)).collect::<Result<Vec<_>, _>>()?;
        let window = window.map(|w| count("window", w)).transpose()?;
        innovation::cumulative(statistics.as_slice(), &dof, &restarts, window)
    })?;
    Ok(Tests::new(py, out))
}

#[derive(IntoPyObject)]
pub(crate) struct Whiteness<'py> {
    autocorrelations: Bound<'py, PyArray2<f64>>,
    bands: Bound<'py, PyArray2<f64>>,
    statistic: f64,
    dof: usize,
    p_value: f64,
}

#[pyfunction]
pub(crate) fn whiteness<'py>(
    py: Python<'py>,
    innovations: PyReadonlyArray2<'py, f64>,
    covs: PyReadonlyArray3<'py, f64>,
    lags: i64,
) -> PyResult<Whiteness<'py>> {
    let rows = array::rows(&innovations, "innovations")?;
    let covs = array::matrices(&covs, "covs")?;
    let out = compute_long(py, || whiteness_::whiteness(&rows, &covs, count("lags", lags)?))?;
    Ok(Whiteness {
        autocorrelations: array::from_matrix(py, &out.autocorrelations)?,
        bands: array::from_matrix(py, &out.bands)?,
        statistic: out.statistic,
        dof: out.dof,
        p_value: out.p_value,
    })
}

/// One column per quantity, one entry per frame; and the summary.
#[derive(IntoPyObject)]
pub(crate) struct Evaluation<'py> {
    targets: Bound<'py, PyArray1<i64>>,
    tracks: Bound<'py, PyArray1<i64>>,
    gospa: Bound<'py, PyArray1<f64>>,
    localisation: Bound<'py, PyArray1<f64>>,
    missed: Bound<'py, PyArray1<f64>>,
    false_tracks: Bound<'py, PyArray1<f64>>,
    ospa: Bound<'py, PyArray1<f64>>,
    all_held: f64,
    switches: usize,
    false_ids: Vec<u64>,
    false_per_minute: f64,
    rmse: f64,
    nees: f64,
    per_target: Vec<Target>,
}

#[derive(IntoPyObject)]
pub(crate) struct Target {
    id: String,
    present: usize,
    held: usize,
    fragments: usize,
    switches: usize,
    longest: f64,
}

impl From<TargetScore> for Target {
    fn from(t: TargetScore) -> Self {
        Self {
            id: t.id,
            present: t.present,
            held: t.held,
            fragments: t.fragments,
            switches: t.switches,
            longest: t.longest,
        }
    }
}

/// Truth as (id, times, positions); frames as their times, offsets into the track arrays, and centres if any.
#[allow(clippy::too_many_arguments)]
#[pyfunction]
#[pyo3(signature = (truth, times, offsets, ids, means, covs, cutoff, order, alpha, centres=None, region=None))]
pub(crate) fn evaluate<'py>(
    py: Python<'py>,
    truth: Vec<(String, PyReadonlyArray1<'py, f64>, PyReadonlyArray2<'py, f64>)>,
    times: PyReadonlyArray1<'py, f64>,
    offsets: Vec<usize>,
    ids: Vec<u64>,
    means: PyReadonlyArray2<'py, f64>,
    covs: PyReadonlyArray3<'py, f64>,
    cutoff: f64,
    order: f64,
    alpha: f64,
    centres: Option<PyReadonlyArray2<'py, f64>>,
    region: Option<f64>,
) -> PyResult<Evaluation<'py>> {
    let mut paths = Vec::new();
    for (id, times, positions) in truth {
        let (times, positions) = (
            array::vector(&times, "truth times")?,
            array::rows(&positions, "truth positions")?,
        );
        let path = TruthPath::new(id, times.as_slice().to_vec(), positions).map_err(|error| to_python(py, &error))?;
        paths.push(path);
    }
    let centres = centres.map(|c| array::rows(&c, "centres")).transpose()?;
    let (n, times) = (means.shape()[1], array::vector(&times, "times")?);
    let (means, covs) = (array::rows(&means, "means")?, array::matrices(&covs, "covs")?);
    let frame = |(k, &time): (usize, &f64)| core::Frame {
        time,
        tracks: (offsets[k]..offsets[k + 1])
            .map(|i| Track {
                id: ids[i],
                time,
                state: trackrs::Gaussian {
                    mean: means[i].clone(),
                    cov: covs[i].clone(),
                },
                last_hit: time,
                hits: 0,
                existence: None,
                extent: None,
                health: None,
            })
            .collect(),
        centre: centres.as_ref().map(|c: &Vec<DVector<f64>>| c[k].clone()),
    };
    debug_assert!(means.iter().all(|m| m.len() == n));
    let frames: Vec<core::Frame> = times.iter().enumerate().map(frame).collect();
    let scoring = Scoring {
        cutoff,
        order,
        alpha,
        region,
    };
    let out = compute_long(py, || core::evaluate(&paths, &frames, &scoring))?;
    let real = |part: fn(&FrameScore) -> f64| PyArray1::from_iter(py, out.frames.iter().map(part));
    let count = |part: fn(&FrameScore) -> usize| {
        PyArray1::from_iter(
            py,
            out.frames.iter().map(|f| i64::try_from(part(f)).unwrap_or(i64::MAX)),
        )
    };
    Ok(Evaluation {
        targets: count(|f| f.targets),
        tracks: count(|f| f.tracks),
        gospa: real(|f| f.gospa.total),
        localisation: real(|f| f.gospa.localisation),
        missed: real(|f| f.gospa.missed),
        false_tracks: real(|f| f.gospa.false_tracks),
        ospa: real(|f| f.ospa.total),
        all_held: out.all_held,
        switches: out.switches,
        false_per_minute: out.false_per_minute,
        rmse: out.rmse,
        nees: out.nees,
        per_target: out.targets.iter().cloned().map(Target::from).collect(),
        false_ids: out.false_ids.clone(),
    })
}
