//! The flat form's data: every eight clusters of a page that follow each other, one part.
//!
//! The chunks of Haar and Aaltonen, "GPU-Driven Rendering Pipelines", SIGGRAPH 2015, with the rule of the cut: a part
//! is left out where the largest parent error of its clusters, on a sphere around the spheres of all of them, is
//! small enough, since each of them is too fine then, or where their least own error is too large anywhere on it.

use nanite_rs::gpu_types::Group;
use nanite_rs::math::{Aabb, Sphere};
use nanite_rs::model::rule::ERROR_STEP;
use nanite_rs::model::{ClusterAddress, Dag};

/// Clusters of a part at most.
pub const PART: usize = 8;

/// The parts of a mesh, in page order, as records of groups: those are what the product's kernels list.
pub fn parts(mesh: &Dag) -> Vec<Group> {
    let of_page = |page: usize| {
        let clusters = mesh.pages.table[page].clusters as usize;
        (0..clusters)
            .step_by(PART)
            .map(move |slot| part(mesh, ClusterAddress::new(page, slot), PART.min(clusters - slot)))
    };
    (0..mesh.pages.table.len()).flat_map(of_page).collect()
}

fn part(mesh: &Dag, first: ClusterAddress, count: usize) -> Group {
    let members: Vec<ClusterAddress> = (0..count as u32).map(|i| ClusterAddress(first.0 + i)).collect();
    let groups = || members.iter().map(|&at| mesh.group_of(at));
    let spheres: Vec<Sphere> = groups().map(|group| group.lod_sphere).collect();
    let bounds = members.iter().fold(Aabb::EMPTY, |bounds, &at| {
        let record = mesh.record(at);
        let corner = |sign: f32| std::array::from_fn(|k| record.center[k] + sign * record.extent[k]);
        let [min, max]: [[f32; 3]; 2] = [corner(-1.0).map(f32::next_down), corner(1.0).map(f32::next_up)];
        bounds.union(&Aabb { min, max })
    });
    let (center, extent) = bounds.center_extent();
    Group {
        lod_sphere: Sphere::of_spheres(&spheres),
        error: groups().map(|group| group.error).fold(0.0, f32::max) * ERROR_STEP,
        first: first.0,
        count: count as u32,
        center,
        extent,
        min_own_error: members.iter().map(|&at| mesh.record(at).error).fold(f32::INFINITY, f32::min),
        ..bytemuck::Zeroable::zeroed()
    }
}
