// The position of a vertex of an instance. Rasterizers and shading fetch it here alone, so that a geometry whose shape
// changes can answer otherwise than by its pages.
// Needs: pages.wgsl.

// Internal units.
fn vertex_position(instance: u32, streams: Streams, vertex: u32) -> vec3<f32> {
    return position_of(streams, vertex);
}
