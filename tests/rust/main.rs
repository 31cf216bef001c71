//! Integration tests: one binary.

mod dag_invariants;
mod format_robust;
mod layering;
mod measure;
mod render_frames;
mod shapes;
