// Stage 3. Groups whose clusters may be drawn -> one bit for each cluster that is, and one more for the large ones:
// the second half of the rule of the cut, the picture's bounds and the backface cone.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> pages: array<u32>;
@group(0) @binding(4) var<storage, read> candidates: array<Candidate>;
@group(0) @binding(5) var<storage, read> culling: Dispatch;
@group(0) @binding(6) var<storage, read_write> drawn: array<u32>;
@group(0) @binding(7) var<storage, read_write> large: array<u32>;
@group(0) @binding(8) var<storage, read_write> counters: Counters;

var<workgroup> drawn_bits: array<atomic<u32>, GROUPS_PER_WORKGROUP>;
var<workgroup> large_bits: array<atomic<u32>, GROUPS_PER_WORKGROUP>;

fn faces_away(instance: u32, record: u32) -> bool {
    let packed = pages[record + RECORD_CONE];
    let cone = vec4<f32>(
        f32(extractBits(i32(packed), 0u, 8u)) / 127.0,
        f32(extractBits(i32(packed), 8u, 8u)) / 127.0,
        f32(extractBits(i32(packed), 16u, 8u)) / 127.0,
        f32(extractBits(i32(packed), 24u, 8u)) / 127.0,
    );
    if cone.w >= 1.0 {
        return false;
    }
    let eye = instances[instance].eye;
    if view.orthographic != 0u {
        return eye.x * cone.x + eye.y * cone.y + eye.z * cone.z >= cone.w;
    }
    let to = reals(record + RECORD_CENTER) - eye;
    let along = to.x * cone.x + to.y * cone.y + to.z * cone.z;
    let distance = sqrt(to.x * to.x + to.y * to.y + to.z * to.z);
    return along >= cone.w * distance + real(record + RECORD_RADIUS);
}

fn cull(candidate: Candidate, group: u32, member: u32) {
    let instance = candidate.instance;
    let cluster = candidate.first + member;
    let record = record_start(page_start(instance, cluster), cluster);
    let at = record + RECORD_LOD_SPHERE;
    let sphere = Sphere(array<f32, 3>(real(at), real(at + 1u), real(at + 2u)), real(at + 3u));
    if exceeds(instance, sphere, real(record + RECORD_ERROR)) {
        return;
    }
    let place = footprint(instance, reals(record + RECORD_CENTER), reals(record + RECORD_EXTENT));
    if !place.seen || (instances[instance].double_sided == 0u && faces_away(instance, record)) {
        return;
    }
    atomicOr(&drawn_bits[group], 1u << member);
    // A patch of n triangles has some sqrt(n / 2) edges across.
    let edge = f32(place.span) / max(sqrt(f32(triangle_count(record)) * 0.5), 1.0);
    if place.clipped || place.span > MAX_SPAN || edge > SMALL_EDGE {
        atomicOr(&large_bits[group], 1u << member);
    }
}

@compute @workgroup_size(WIDTH)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let group = lane / 32u;
    let member = lane % 32u;
    let number = workgroup_number(workgroup) * GROUPS_PER_WORKGROUP + group;
    let exists = number < min(culling.count, arrayLength(&candidates));
    if member == 0u {
        atomicStore(&drawn_bits[group], 0u);
        atomicStore(&large_bits[group], 0u);
    }
    workgroupBarrier();
    if exists {
        let candidate = candidates[number];
        if member == 0u {
            atomicAdd(&counters.visited_clusters, candidate.count);
        }
        if member < candidate.count {
            cull(candidate, group, member);
        }
    }
    workgroupBarrier();
    if exists && member == 0u {
        drawn[number] = atomicLoad(&drawn_bits[group]);
        large[number] = atomicLoad(&large_bits[group]);
    }
}
