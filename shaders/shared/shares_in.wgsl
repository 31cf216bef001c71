// Parts of clusters that others listed, a workgroup for each.

const SHARED: bool = true;

@group(0) @binding(12) var<storage, read> shares: Shares;

fn share_of(workgroup: u32) -> Share {
    return shares.parts[workgroup];
}

fn share_out(share: Share, lane: u32, parts: u32) -> Share {
    return share;
}
