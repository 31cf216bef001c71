// Defers a node to the second pass: appends it to the occluded queue.
// Needs: view, occluded_queue, occluded_dispatch.

// The second pass looks at this node again. Pages of shadow maps have none.
fn defer(item: TraversalItem) {
    if view.history == HISTORY_PAGES {
        return;
    }
    let at = atomicAdd(&occluded_dispatch.count, 1u);
    // The first entry of a workgroup makes it.
    if at % WIDTH == 0u {
        atomicMax(&occluded_dispatch.x, min(at / WIDTH + 1u, MAX_WORKGROUPS));
        atomicMax(&occluded_dispatch.y, at / WIDTH / MAX_WORKGROUPS + 1u);
        atomicMax(&occluded_dispatch.z, 1u);
    }
    if at < arrayLength(&occluded_queue) {
        occluded_queue[at] = item;
    }
}
