// Clusters of a list, a workgroup for each. Of one with much to fill this workgroup lists parts, which workgroups of the
// next dispatch take, as many as there is room for; the rest it fills itself.

const SHARED: bool = false;

@group(0) @binding(12) var<storage, read_write> shares: SharesOut;

var<workgroup> kept: Share;

fn share_of(workgroup: u32) -> Share {
    return Share(workgroup, 0u, 1u, 1u);
}

fn share_out(share: Share, lane: u32, parts: u32) -> Share {
    if lane == 0u {
        var first = 0u;
        if parts > 1u {
            let room = arrayLength(&shares.parts);
            let at = min(atomicAdd(&shares.count, parts), room);
            first = min(parts, room - at);
            for (var i = 0u; i < first; i++) {
                shares.parts[at + i] = Share(share.index, i, i + 1u, parts);
            }
            atomicMax(&shares.x, at + first);
            atomicStore(&shares.y, 1u);
            atomicStore(&shares.z, 1u);
        }
        kept = Share(share.index, first, parts, parts);
    }
    workgroupBarrier();
    return kept;
}
