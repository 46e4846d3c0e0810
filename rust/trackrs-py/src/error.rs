//! `trackrs::Error` to the exceptions of `trackrs.errors`, and panics to `InternalError`.

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;
use trackrs::Error;

thread_local! {
    /// What a Python function called by the core has raised, until the call into the core ends.
    static RAISED: RefCell<Option<PyErr>> = const { RefCell::new(None) };
}

/// Keeps the exception of a Python function, to be raised as it is when the core returns.
pub(crate) fn keep_raised(error: PyErr) {
    RAISED.with_borrow_mut(|raised| {
        raised.get_or_insert(error);
    });
}

/// The same for an error found where the core cannot be told.
pub(crate) fn keep_error(error: &Error) {
    Python::attach(|py| {
        let error = to_python(py, error);
        keep_raised(error);
    });
}

/// That exception, which then counts as dealt with.
pub(crate) fn raised() -> Option<PyErr> {
    RAISED.with_borrow_mut(Option::take)
}

static MODULE: PyOnceLock<Py<PyModule>> = PyOnceLock::new();

/// The exception of this name in `trackrs.errors`.
pub(crate) fn exception(py: Python<'_>, name: &str, message: String) -> PyErr {
    let module = MODULE.get_or_try_init(py, || Ok::<_, PyErr>(py.import("trackrs.errors")?.unbind()));
    let class = module.and_then(|m| Ok(m.bind(py).getattr(name)?.cast_into::<PyType>()?));
    match class {
        Ok(class) => PyErr::from_type(class, message),
        Err(error) => error,
    }
}

/// The exception for an error of the core.
pub(crate) fn to_python(py: Python<'_>, error: &Error) -> PyErr {
    if let Some(raised) = raised() {
        return raised;
    }
    let name = match error {
        Error::NotPositiveDefinite { .. } => "NotPositiveDefiniteError",
        Error::DimensionMismatch { .. } | Error::Shape { .. } => "DimensionError",
        Error::NonFinite { .. } | Error::Overflow { .. } => "NonFiniteError",
        Error::InvalidParameter { .. } => "ParameterError",
        Error::TimeReversed { .. } => "TimeError",
        Error::UnknownSensor { .. } => "UnknownSensorError",
        Error::Unobservable { .. } => "UnobservableError",
        Error::CorruptState { .. } | Error::CannotSave { .. } => "StateError",
        Error::Strict { .. } => "StrictError",
        _ => "InternalError",
    };
    exception(py, name, error.to_string())
}

/// Runs `work` with the interpreter released. Errors and panics become exceptions.
pub(crate) fn compute<T: Send>(py: Python<'_>, work: impl FnOnce() -> trackrs::Result<T> + Send) -> PyResult<T> {
    match py.detach(|| catch_unwind(AssertUnwindSafe(work))) {
        Ok(Ok(value)) => raised().map_or(Ok(value), Err),
        Ok(Err(error)) => Err(to_python(py, &error)),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text
                .or_else(|| panic.downcast_ref::<&str>().copied())
                .unwrap_or("panic");
            Err(exception(
                py,
                "InternalError",
                format!("internal error, please report it: {text}"),
            ))
        }
    }
}

/// The same for what computes a value and may take long: Ctrl-C ends it.
pub(crate) fn compute_long<T: Send>(py: Python<'_>, work: impl FnOnce() -> trackrs::Result<T> + Send) -> PyResult<T> {
    compute(py, || trackrs::interrupt::until(go_on, work))
}

/// Whether nobody has pressed Ctrl-C; if so, the exception is kept.
pub(crate) fn go_on() -> bool {
    let checked = Python::attach(|py| -> PyResult<()> { py.check_signals() });
    checked.map_err(keep_raised).is_ok()
}

/// Panics in the core, as nothing should, to show what then reaches Python.
#[pyfunction(name = "_panic")]
pub(crate) fn panic_on_purpose(py: Python<'_>) -> PyResult<()> {
    compute(py, || panic!("on purpose"))
}

/// A count that the user may have given as any whole number.
pub(crate) fn count(name: &str, value: i64) -> trackrs::Result<usize> {
    usize::try_from(value).map_err(|_| Error::invalid(name, value, "must be a count"))
}
