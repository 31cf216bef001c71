//! The one match from [`Error`] to Python exceptions.
//!
//! The classes live in `python/nanite_rs/exceptions.py`, because each has two bases.

use std::any::Any;

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::error::Error;

/// The class in `nanite_rs.exceptions` that stands for an error; `None` is Python's own KeyboardInterrupt.
fn class_name(error: &Error) -> Option<&'static str> {
    Some(match error {
        Error::Argument { .. } => "ArgumentError",
        Error::NonFinite { .. }
        | Error::IndexOutOfRange { .. }
        | Error::EmptyMesh(_)
        | Error::TooLarge(_) => "MeshError",
        Error::Cancelled => return None,
        Error::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound => "MissingFileError",
        Error::Io { .. } => "FileError",
        Error::Format { .. } | Error::Source { .. } => "FormatError",
        Error::StaleHandle(_) => "StaleHandleError",
        Error::Backend { .. } => "BackendError",
        Error::Forked(_) => "ForkError",
        Error::Invariant(_) => "InvariantError",
    })
}

/// Why Python could not read what it was asked for.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub(super) struct Refused {
    /// The class in `nanite_rs.exceptions` that stands for it.
    pub class: String,
    /// What happened.
    pub message: String,
}

/// An exception of `nanite_rs.exceptions`.
pub(super) fn exception(py: Python<'_>, class: &str, arguments: Bound<'_, PyTuple>) -> PyErr {
    let made = py
        .import("nanite_rs.exceptions")
        .and_then(|module| module.getattr(class))
        .and_then(|class| class.call1(arguments));
    match made {
        Ok(value) => PyErr::from_value(value),
        Err(error) => error,
    }
}

/// An exception of `nanite_rs.exceptions` with a message.
pub(super) fn exception_with_message(py: Python<'_>, class: &str, message: &str) -> PyErr {
    match (message,).into_pyobject(py) {
        Ok(arguments) => exception(py, class, arguments),
        Err(error) => error,
    }
}

/// An array or value of the wrong type: `DtypeError`.
pub(super) fn dtype_error(py: Python<'_>, argument: &str, message: &str) -> PyErr {
    exception_with_message(py, "DtypeError", &format!("{argument}: {message}"))
}

/// A value out of range or of the wrong shape: `ArgumentError`.
pub(super) fn argument_error(py: Python<'_>, argument: &'static str, message: impl Into<String>) -> PyErr {
    to_python(py, Error::argument(argument, message))
}

/// The Python exception for an error.
pub(super) fn to_python(py: Python<'_>, error: Error) -> PyErr {
    let Some(class) = class_name(&error) else {
        return PyKeyboardInterrupt::new_err(());
    };
    if let Error::Io { path, source } = &error {
        if let Some(refused) = source.get_ref().and_then(|inner| inner.downcast_ref::<Refused>()) {
            return exception_with_message(py, &refused.class, &error.to_string());
        }
        // OSError's own arguments, so that errno, strerror and filename are set.
        let reason = source.to_string();
        let reason = reason.split(" (os error").next().unwrap_or(&reason).to_owned();
        // Some errors come wrapped, with their kind alone.
        let number = source.raw_os_error().or(match source.kind() {
            std::io::ErrorKind::NotFound => Some(2),
            std::io::ErrorKind::PermissionDenied => Some(13),
            _ => None,
        });
        let arguments = (number, reason, path.as_os_str().to_owned());
        return match arguments.into_pyobject(py) {
            Ok(arguments) => exception(py, class, arguments),
            Err(error) => error,
        };
    }
    exception_with_message(py, class, &error.to_string())
}

/// `InternalError` from what a panic threw.
pub(super) fn panic_to_python(py: Python<'_>, payload: &(dyn Any + Send)) -> PyErr {
    let text = payload
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message");
    exception_with_message(py, "InternalError", &format!("a fault of nanite_rs, please report it: {text}"))
}
