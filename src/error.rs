//! The one error type of the crate: a variant per cause, each naming where the fault is.

use std::borrow::Cow;
use std::path::PathBuf;

/// Shorthand for results of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Everything that can go wrong. `python/errors.rs` maps each variant to one Python exception.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An argument has the wrong shape, type, range or combination.
    #[error("{argument}: {message}")]
    Argument {
        /// Name of the argument as the caller knows it.
        argument: &'static str,
        /// What was expected and what was found.
        message: String,
    },
    /// A coordinate or attribute is NaN or infinite.
    #[error("{argument}[{index}] is not finite: {value:?}")]
    NonFinite {
        /// Name of the array.
        argument: Cow<'static, str>,
        /// Row of the array.
        index: usize,
        /// The offending row.
        value: Vec<f64>,
    },
    /// A face refers to a vertex that does not exist.
    #[error("faces[{face}] refers to vertex {index}, but there are {vertices} vertices")]
    IndexOutOfRange {
        /// Row of `faces`.
        face: usize,
        /// The offending index.
        index: i64,
        /// Number of vertices.
        vertices: usize,
    },
    /// Nothing is left to build from.
    #[error("the mesh is empty: {0}")]
    EmptyMesh(String),
    /// The mesh exceeds what 32-bit identities can address.
    #[error("the mesh is too large: {0}")]
    TooLarge(String),
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// The operating system refused a file operation.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// File in question.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file or byte string is not a valid `.nanite` mesh.
    #[error("{name}: not a valid .nanite file at byte {offset}: {message}")]
    Format {
        /// File name, or `<bytes>`.
        name: String,
        /// Byte offset of the fault.
        offset: u64,
        /// What was expected and what was found.
        message: String,
    },
    /// A file of another program is not what its format defines.
    #[error("{place}: {message}")]
    Source {
        /// Line, element or byte.
        place: String,
        /// What was expected and what was found.
        message: String,
    },
    /// A scene handle refers to something that was removed.
    #[error("stale handle: {0} was removed from the scene")]
    StaleHandle(String),
    /// The requested backend is not available here.
    #[error("backend {backend:?} is not available: {message}")]
    Backend {
        /// Name of the backend.
        backend: String,
        /// Why, and what is missing.
        message: String,
    },
    /// Another thread held something when this process was forked, and nobody gives it back.
    #[error(
        "{0} was in use by another thread when this process was forked, and stays so here: make another one in this \
         process, or start workers with \"spawn\" or \"forkserver\""
    )]
    Forked(&'static str),
    /// An invariant of the built mesh does not hold: a bug, or a damaged file.
    #[error("invariant violated: {0}")]
    Invariant(String),
}

impl Error {
    /// An [`Error::Argument`].
    pub fn argument(argument: &'static str, message: impl Into<String>) -> Self {
        Self::Argument { argument, message: message.into() }
    }

    /// Whether the same call may succeed the next time: see [`is_passing`].
    pub fn is_passing(&self) -> bool {
        matches!(self, Self::Io { source, .. } if is_passing(source))
    }
}

/// Whether a disk or a network may do better the next time. What says that something is not there, is shorter, or must not
/// be read stays so until somebody changes it; timeouts, dropped connections and what has no name of its own may pass.
pub fn is_passing(error: &std::io::Error) -> bool {
    use std::io::ErrorKind;
    !matches!(
        error.kind(),
        ErrorKind::NotFound
            | ErrorKind::PermissionDenied
            | ErrorKind::UnexpectedEof
            | ErrorKind::InvalidData
            | ErrorKind::InvalidInput
            | ErrorKind::Unsupported
    )
}
