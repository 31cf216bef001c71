// Appends to the traversal queue of the next level.
// Needs: next, items_out.

// Room for `count` entries; the number of the first. Counts on past the end, so that the host learns the need.
fn claim(count: u32) -> u32 {
    let at = atomicAdd(&next.count, count);
    let workgroups = (at + count + WIDTH - 1u) / WIDTH;
    // Most entries find room in a workgroup that is there for others.
    if workgroups > (at + WIDTH - 1u) / WIDTH {
        atomicMax(&next.x, min(workgroups, MAX_WORKGROUPS));
        atomicMax(&next.y, (workgroups + MAX_WORKGROUPS - 1u) / MAX_WORKGROUPS);
        atomicMax(&next.z, 1u);
    }
    return at;
}

fn append(at: u32, item: TraversalItem) {
    if at < arrayLength(&items_out) {
        items_out[at] = item;
    }
}
