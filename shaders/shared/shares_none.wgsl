// Clusters of a list, a workgroup for each, whatever there is to fill.

const SHARED: bool = false;

fn share_of(workgroup: u32) -> Share {
    return Share(workgroup, 0u, 1u, 1u);
}

fn share_out(share: Share, lane: u32, parts: u32) -> Share {
    return share;
}
