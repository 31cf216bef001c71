// The rule of the cut: src/model/rule.rs on src/math/project.rs.
// Needs: exact.wgsl.

// What the rule needs of an instance that is to be seen, read once for all spheres that are looked at.
struct LodView {
    object_to_eye: array<vec4<f32>, 3>,
    scale: f32,
    rounding: f32,
}

fn lod_view(instance: u32) -> LodView {
    return LodView(instances[instance].object_to_eye, instances[instance].lod_scale, instances[instance].rounding);
}

// Where a sphere's centre is in camera space, and how far that is.
fn center_of(lod: LodView, sphere: Sphere) -> vec4<f32> {
    let at = homogeneous(lod.object_to_eye, sphere.center);
    return vec4<f32>(at, root(inner(at, at)));
}

fn pixels_at(lod: LodView, at: vec4<f32>, sphere_radius: f32, error: f32) -> f32 {
    if error <= 0.0 {
        return error;
    }
    let world = times(error + lod.rounding, lod.scale);
    if view.lod_near == 0.0 {
        return world * view.lod_focal;
    }
    let radius = times(sphere_radius, lod.scale) + world;
    let distance = at.w - radius;
    let depth = -at.z - radius;
    var sec2 = view.lod_widest;
    if depth > 0.0 {
        let tangent = quotient(root(times(at.x, at.x) + times(at.y, at.y)) + radius, depth);
        sec2 = min(1.0 + times(tangent, tangent), sec2);
    }
    return quotient(world * view.lod_focal * sec2, max(distance, view.lod_near));
}

fn error_pixels(lod: LodView, sphere: Sphere, error: f32) -> f32 {
    return pixels_at(lod, center_of(lod, sphere), sphere.radius, error);
}

// True when an error on a sphere is too large to be drawn.
fn exceeds(lod: LodView, sphere: Sphere, error: f32) -> bool {
    return error_pixels(lod, sphere, error) > view.tau;
}

fn least_pixels_at(lod: LodView, at: vec4<f32>, sphere_radius: f32, error: f32) -> f32 {
    if error <= 0.0 {
        return error;
    }
    let world = times(error + lod.rounding, lod.scale);
    if view.lod_near == 0.0 {
        return world * view.lod_focal;
    }
    let distance = at.w + times(sphere_radius, lod.scale);
    return quotient((1.0 - LEAST_MARGIN) * world * view.lod_focal, max(distance, view.lod_near));
}

// Whether clusters inside of a sphere may be in the cut, from the largest parent error and the least of their own: one is
// too large to be drawn, and the other not, on whatever sphere inside of this one.
fn may_be_in_cut(lod: LodView, sphere: Sphere, parent_error: f32, own_error: f32) -> bool {
    let at = center_of(lod, sphere);
    return pixels_at(lod, at, sphere.radius, parent_error) > view.tau
        && !(least_pixels_at(lod, at, sphere.radius, own_error) > view.tau);
}
