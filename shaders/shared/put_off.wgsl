// Putting off what the pyramid of an earlier frame hides. Needs `later` and `later_level`.

// The second phase looks at this node again.
fn put_off(visit: Visit) {
    let at = atomicAdd(&later_level.count, 1u);
    // The first entry of a workgroup makes it.
    if at % WIDTH == 0u {
        atomicMax(&later_level.x, min(at / WIDTH + 1u, MAX_WORKGROUPS));
        atomicMax(&later_level.y, at / WIDTH / MAX_WORKGROUPS + 1u);
        atomicMax(&later_level.z, 1u);
    }
    if at < arrayLength(&later) {
        later[at] = visit;
    }
}
