// Cluster records for culling, four words at a time: src/model/cluster.rs.
// Needs: places.wgsl, pages, pages_1, pages_2, pages_3.

// Four words of a record, of which RECORD_* names the first.
fn record_quad(record: u32, first: u32) -> vec4<u32> {
    let at = record + first;
    if PAGE_ARRAYS == 1u {
        return pages[at / 4u];
    }
    let quad = place_in_array(at) / 4u;
    switch page_array(at) {
        case 0u: { return pages[quad]; }
        case 1u: { return pages_1[quad]; }
        case 2u: { return pages_2[quad]; }
        default: { return pages_3[quad]; }
    }
}

// What the rule of the cut and the lists need.
struct Detail {
    lod_sphere: Sphere,
    error: f32,
    triangles: u32,
    material: u32,
    refined_page: u32,
}

fn detail_of(record: u32) -> Detail {
    let sphere = bitcast<vec4<f32>>(record_quad(record, RECORD_LOD_SPHERE));
    let counts = record_quad(record, RECORD_ERROR);
    let last = record_quad(record, RECORD_REFINED);
    return Detail(
        Sphere(sphere.xyz, sphere.w),
        bitcast<f32>(counts.x),
        counts.z >> 8u & 0xffu,
        last.z,
        last.w,
    );
}
