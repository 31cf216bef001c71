//! The extension module `nanite_rs._core`: thin, checked entry points. What users see, with docstrings and
//! defaults, is Python over it (`python/nanite_rs/`).

mod arrays;
mod assembly;
mod basis;
mod blocks;
mod calls;
mod displace;
mod errors;
mod image;
mod measure;
mod mesh;
mod packing;
mod read;
mod rebake;
mod remote;
mod renderer;
mod scene;
mod tables;
mod tile;
mod triangle_mesh;

use pyo3::exceptions::PyImportError;
use pyo3::prelude::*;

use crate::{format, processor, threads};

/// The compiled part of nanite_rs. Use the package `nanite_rs`, not this module.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let missing = processor::missing();
    if !missing.is_empty() {
        return Err(PyImportError::new_err(format!(
            "nanite_rs is compiled for x86-64-v2, processors since 2009; this one has no {}. From source it builds for \
             older ones with the environment variable RUSTFLAGS=-Ctarget-cpu=x86-64",
            missing.join(", ")
        )));
    }
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("MOST_THREADS", threads::MOST_THREADS)?;
    module.add("FINE_PART", format::FINE_PART)?;
    module.add("FIRST_READ", format::FIRST_READ)?;
    module.add_function(wrap_pyfunction!(calls::set_num_threads, module)?)?;
    module.add_function(wrap_pyfunction!(calls::num_threads, module)?)?;
    module.add_class::<blocks::BlockBuild>()?;
    module.add_function(wrap_pyfunction!(blocks::build_memory, module)?)?;
    module.add_function(wrap_pyfunction!(remote::retry_pauses, module)?)?;
    module.add_class::<mesh::Mesh>()?;
    module.add_class::<mesh::Skin>()?;
    module.add_class::<mesh::Waves>()?;
    module.add_class::<rebake::Unbaked>()?;
    module.add_class::<mesh::Cut>()?;
    module.add_class::<mesh::ChannelRows>()?;
    module.add_class::<triangle_mesh::TriangleMesh>()?;
    module.add_function(wrap_pyfunction!(triangle_mesh::skinned, module)?)?;
    module.add_function(wrap_pyfunction!(mesh::decimate, module)?)?;
    module.add_function(wrap_pyfunction!(tables::cluster_table, module)?)?;
    module.add_function(wrap_pyfunction!(tables::cluster_arrays, module)?)?;
    module.add_function(wrap_pyfunction!(tables::group_table, module)?)?;
    module.add_function(wrap_pyfunction!(tables::page_table, module)?)?;
    module.add_function(wrap_pyfunction!(tables::page_table_of_file, module)?)?;
    module.add_function(wrap_pyfunction!(displace::displace, module)?)?;
    module.add_function(wrap_pyfunction!(displace::heightfield, module)?)?;
    module.add_function(wrap_pyfunction!(measure::surface_distance, module)?)?;
    module.add_function(wrap_pyfunction!(measure::closest_points, module)?)?;
    module.add_function(wrap_pyfunction!(read::read_ply, module)?)?;
    module.add_function(wrap_pyfunction!(read::whole_ply_rows, module)?)?;
    module.add_function(wrap_pyfunction!(read::read_stl, module)?)?;
    module.add_function(wrap_pyfunction!(read::read_obj, module)?)?;
    module.add_function(wrap_pyfunction!(read::read_off, module)?)?;
    module.add_function(wrap_pyfunction!(read::triangulate, module)?)?;
    module.add_function(wrap_pyfunction!(read::strips, module)?)?;
    module.add_class::<tile::Tiles>()?;
    module.add_class::<tile::Piece>()?;
    module.add_function(wrap_pyfunction!(packing::vertex_order, module)?)?;
    module.add_function(wrap_pyfunction!(packing::pack_vertices, module)?)?;
    module.add_function(wrap_pyfunction!(packing::pack_faces, module)?)?;
    module.add_function(wrap_pyfunction!(packing::pack_directions, module)?)?;
    module.add_function(wrap_pyfunction!(basis::compressed, module)?)?;
    module.add_function(wrap_pyfunction!(basis::encode_basis, module)?)?;
    module.add_class::<remote::Traffic>()?;
    module.add_class::<remote::Input>()?;
    module.add_class::<remote::Answers>()?;
    module.add_class::<image::Image>()?;
    module.add_class::<image::EnvironmentMap>()?;
    module.add_class::<assembly::Assembly>()?;
    module.add_function(wrap_pyfunction!(assembly::check_poses, module)?)?;
    module.add_class::<scene::Scene>()?;
    module.add_function(wrap_pyfunction!(scene::check_light, module)?)?;
    module.add_class::<renderer::Renderer>()?;
    module.add_class::<renderer::Frame>()?;
    module.add_function(wrap_pyfunction!(renderer::check_camera, module)?)?;
    module.add_function(wrap_pyfunction!(renderer::check_pose, module)?)?;
    Ok(())
}
