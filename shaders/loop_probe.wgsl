// A loop of many trips: drivers that stop loops early give another last number.

@group(0) @binding(0) var<storage, read_write> state: array<u32, 2>;

@compute @workgroup_size(1)
fn main() {
    var number = state[1];
    for (var trip = 0u; trip < state[0]; trip++) {
        number = (number ^ (number >> 7u)) * 1664525u + trip;
    }
    state[1] = number;
}
