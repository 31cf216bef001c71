// Finds drivers that stop loops early: after a loop of many iterations, such a driver gives another last number.
// One invocation.
// Reads the number of iterations. Writes the last number.

@group(0) @binding(0) var<storage, read_write> state: array<u32, 2>;

@compute @workgroup_size(1)
fn main() {
    var number = state[1];
    for (var trip = 0u; trip < state[0]; trip++) {
        number = (number ^ (number >> 7u)) * 1664525u + trip;
    }
    state[1] = number;
}
