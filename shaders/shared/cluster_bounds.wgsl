// Where a cluster of an instance lies, and which way it faces. Culling asks here alone, so that a geometry whose shape
// changes can answer otherwise than by its pages.
// Needs: records.wgsl.

// A box, the radius about its centre, and the packed cone.
struct ClusterBounds {
    center: vec3<f32>,
    radius: f32,
    extent: vec3<f32>,
    cone: u32,
}

fn cluster_bounds(instance: u32, record: u32) -> ClusterBounds {
    let center = record_quad(record, RECORD_CENTER);
    let extent = record_quad(record, RECORD_EXTENT);
    return ClusterBounds(bitcast<vec3<f32>>(center.xyz), bitcast<f32>(center.w), bitcast<vec3<f32>>(extent.xyz), extent.w);
}
