// What rasterizers draw of a view: clusters of its visible list.
// Needs: pages.wgsl, seen.wgsl, visible, draws.

@group(0) @binding(0) var<storage, read> instances: array<Instance>;
@group(0) @binding(10) var<uniform> view: View;
@group(0) @binding(11) var<storage, read> numbers: array<u32>;

// The number in the visible list of entry `index` of a list; NONE behind its end.
fn listed(list: u32, index: u32) -> u32 {
    let room = arrayLength(&numbers) / 2u;
    let there = index < min(draws[list].count, room);
    let number = numbers[number_slot(list, select(0u, index, there), room)];
    return select(NONE, number, there && number < arrayLength(&visible));
}

// Before anything of an entry of the visible list is drawn.
fn look_at(number: u32) {}

fn mirrors(instance: u32) -> bool {
    return instances[instance].mirrored != 0u;
}

// Whether a cluster shows its back faces.
fn shows_backs(instance: u32, record: u32) -> bool {
    return two_sided(instance, record);
}
