// The rule of the cut: src/model/rule.rs on src/math/project.rs.

fn error_pixels(instance: u32, sphere: Sphere, error: f32) -> f32 {
    if error <= 0.0 {
        return error;
    }
    let world = error * instances[instance].lod_scale;
    let focal = instances[instance].lod_focal;
    let near = instances[instance].lod_near;
    if near == 0.0 {
        return world * focal;
    }
    let at = homogeneous(instances[instance].object_to_eye, vector(sphere.center));
    let radius = sphere.radius * instances[instance].lod_scale + world;
    let distance = sqrt(at.x * at.x + at.y * at.y + at.z * at.z) - radius;
    let depth = -at.z - radius;
    var sec2 = view.lod_widest;
    if depth > 0.0 {
        let tangent = (sqrt(at.x * at.x + at.y * at.y) + radius) / depth;
        sec2 = min(1.0 + tangent * tangent, sec2);
    }
    return world * focal * sec2 / max(distance, near);
}

// True when an error on a sphere is too large to be drawn.
fn exceeds(instance: u32, sphere: Sphere, error: f32) -> bool {
    return error_pixels(instance, sphere, error) > view.tau;
}

fn least_pixels(instance: u32, sphere: Sphere, error: f32) -> f32 {
    if error <= 0.0 {
        return error;
    }
    let world = error * instances[instance].lod_scale;
    let focal = instances[instance].lod_focal;
    let near = instances[instance].lod_near;
    if near == 0.0 {
        return world * focal;
    }
    let at = homogeneous(instances[instance].object_to_eye, vector(sphere.center));
    let distance = sqrt(at.x * at.x + at.y * at.y + at.z * at.z) + sphere.radius * instances[instance].lod_scale;
    return (1.0 - LEAST_MARGIN) * world * focal / max(distance, near);
}

// True when no error of at least this, on whatever sphere inside of this one, is small enough to be drawn.
fn exceeds_throughout(instance: u32, sphere: Sphere, error: f32) -> bool {
    return least_pixels(instance, sphere, error) > view.tau;
}

// Whether clusters inside of a sphere may be in the cut, from the largest parent error and the least of their own.
fn may_be_in_cut(instance: u32, sphere: Sphere, parent_error: f32, own_error: f32) -> bool {
    return exceeds(instance, sphere, parent_error) && !exceeds_throughout(instance, sphere, own_error);
}
