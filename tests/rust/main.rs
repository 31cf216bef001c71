//! Integration tests: one binary.

mod dag_invariants;
mod shapes;
