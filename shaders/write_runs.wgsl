// Runs of words to where they belong among those of the pages on the device: what an update changes of a mesh lies all over
// its pages, and a command for each run would cost more than the run does.
// One workgroup writes one run.
// Reads the runs and their words. Writes an array of pages.

struct Run {
    // Where its words are.
    from_word: u32,
    // Where they go.
    to_word: u32,
    count: u32,
    unused: u32,
}

@group(0) @binding(0) var<storage, read> runs: array<Run>;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read_write> written: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = workgroup_number(workgroup);
    if number >= arrayLength(&runs) {
        return;
    }
    let run = runs[number];
    for (var k = lane; k < run.count; k += WIDTH) {
        written[run.to_word + k] = words[run.from_word + k];
    }
}
