// The flat form, second step: parts that may hold a cluster to draw -> one bit for each cluster that is, as
// cluster_cull.wgsl does it for groups, with the whole rule of the cut: members of a part may be of several groups, so
// each looks up the parent error of its own.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> pages: array<u32>;
@group(0) @binding(4) var<storage, read> candidates: array<CandidateGroup>;
@group(0) @binding(5) var<storage, read> culling: Dispatch;
@group(0) @binding(6) var<storage, read_write> drawn: array<u32>;
@group(0) @binding(7) var<storage, read_write> marks: array<Marks>;
@group(0) @binding(8) var<storage, read_write> counters: Counters;
@group(0) @binding(9) var<storage, read> groups: array<Group>;
// Of each page: the first group of its mesh.
@group(0) @binding(10) var<storage, read> group_bases: array<u32>;
@group(0) @binding(11) var<storage, read> pages_1: array<u32>;
@group(0) @binding(12) var<storage, read> pages_2: array<u32>;
@group(0) @binding(13) var<storage, read> pages_3: array<u32>;

const PARTS_PER_WORKGROUP: u32 = WIDTH / PART;

var<workgroup> drawn_bits: array<atomic<u32>, PARTS_PER_WORKGROUP>;
var<workgroup> large_bits: array<atomic<u32>, PARTS_PER_WORKGROUP>;

fn cull(candidate: CandidateGroup, part: u32, member: u32) {
    let instance = candidate.instance;
    let cluster = candidate.first + member;
    let record = record_start(page_start(instance, cluster), cluster);
    let base = group_bases[instances[instance].first_page + (cluster >> PAGE_SLOT_BITS)];
    let group = base + page_word(record + RECORD_GROUP);
    if !exceeds(lod_view(instance), groups[group].lod_sphere, groups[group].error) {
        return;
    }
    let at = record + RECORD_LOD_SPHERE;
    let sphere = Sphere(reals(at), real(at + 3u));
    if exceeds(lod_view(instance), sphere, real(record + RECORD_ERROR)) {
        return;
    }
    let place = footprint(instances[instance].screen, reals(record + RECORD_CENTER), reals(record + RECORD_EXTENT));
    let away = instances[instance].double_sided == 0u
        && faces_away(instance, reals(record + RECORD_CENTER), real(record + RECORD_RADIUS), page_word(record + RECORD_CONE));
    if !place.seen || away {
        return;
    }
    let bit = 1u << member;
    atomicOr(&drawn_bits[part], bit);
    let edge = f32(place.span) / max(sqrt(f32(triangle_count(record)) * 0.5), 1.0);
    if place.clipped || place.span > MAX_SPAN || edge > SMALL_EDGE {
        atomicOr(&large_bits[part], bit);
        atomicAdd(&counters.triangles_large, triangle_count(record));
    } else {
        atomicAdd(&counters.triangles_small, triangle_count(record));
    }
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let part = lane / PART;
    let member = lane % PART;
    let number = workgroup_number(workgroup) * PARTS_PER_WORKGROUP + part;
    let exists = number < min(culling.count, arrayLength(&candidates));
    if member == 0u {
        atomicStore(&drawn_bits[part], 0u);
        atomicStore(&large_bits[part], 0u);
    }
    workgroupBarrier();
    if exists {
        let candidate = candidates[number];
        if member == 0u {
            atomicAdd(&counters.visited_clusters, candidate.count);
        }
        if member < candidate.count {
            cull(candidate, part, member);
        }
    }
    workgroupBarrier();
    if exists && member == 0u {
        drawn[number] = atomicLoad(&drawn_bits[part]);
        marks[number] = Marks(atomicLoad(&large_bits[part]), 0u, 0u, 0u);
    }
}
