// How exact what is drawn of a cluster is: `receiver_error` of src/cpu/surface.rs.
// Needs: exact.wgsl, pages.wgsl, instances.

// By how much what is drawn of a cluster may be off its source, world units: its own error, and rounding.
fn receiver_error(instance: u32, record: u32) -> f32 {
    let own = max(real(record + RECORD_ERROR), 0.0);
    return times(own + instances[instance].rounding + SHADOW_ROUNDING, instances[instance].lod_scale);
}
