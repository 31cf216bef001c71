//! Integration tests: one binary.

mod budgets;
mod channels;
mod dag_invariants;
mod damage;
mod depth_only;
mod environment;
#[cfg(feature = "gpu")]
mod exact;
mod external;
mod format_robust;
#[cfg(feature = "gpu")]
mod gpu_parity;
#[cfg(feature = "gpu")]
mod gpu_raster;
mod layering;
#[cfg(feature = "gpu")]
mod many_materials;
mod materials;
mod measure;
#[cfg(feature = "gpu")]
mod own_kernel;
mod rebake;
mod render_frames;
mod samples;
mod seams;
#[cfg(feature = "gpu")]
mod shader_validation;
#[cfg(feature = "gpu")]
mod shadow_lookup;
#[cfg(feature = "gpu")]
mod shadow_pictures;
mod shadows;
mod shapes;
#[cfg(feature = "gpu")]
mod stage_truth;
mod stored_materials;
mod streaming;
mod tiles;
#[cfg(feature = "gpu")]
mod traversal;
mod waves;
