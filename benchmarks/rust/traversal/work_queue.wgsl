// The walk of the hierarchies in one dispatch: workgroups that stay take (instance, node) items from a bounded ring and
// put children back, until none is left. Writes the same bits of groups as node_cull.wgsl, without occlusion.
//
// WGSL promises no progress of one workgroup while another waits, and atomics that order nothing but themselves. So
// nobody waits, and an item travels inside one atomic word.
//
// A push takes a ticket from `tail`, a pop takes one from `head`; ticket t is slot t % RING in lap t / RING. The word
// of a slot is lap << PAYLOAD_BITS | payload, payload 0 meaning empty, and both ends touch it once, by an atomicMax:
//   put   to (lap, item);
//   take  to (lap + 1, empty).
// So words only grow, and each value of a slot is replaced once, by one lane, which is told what it replaced. The rules:
//   1. Whoever replaces an item owns it. That is the pop of the same ticket, or, where the ring is full or a lane fell a
//      lap behind, a later put or take, which then has one more thing to do. The late pop finds the slot ahead: nothing.
//   2. A put that finds the slot ahead of it (its pop was here first) did not put: its lane walks below that node itself,
//      with a stack. So it does where tickets have run out.
//   3. A worker leaves when it finds head at or past tail, and no roots. Its own tickets are below the tail that it
//      sees, since one word has one order for all; so each of them was popped by somebody, after it was put (2.) or
//      not at all, and whoever popped it does it before leaving.
// Hence every item is done once by the time all have left, whichever workgroups run, in turn or at once; and a step
// of a lane is a bounded number of operations: claim() tries PATIENCE times to advance head by a comparison, and then
// once by adding, which cannot fail. What that passes over too early costs the putter its own walk (2.), nothing else.
// `outstanding` says only whether staying may pay. It may be off for a moment; then a worker leaves early, or late.
//
// Tickets and laps: Broker Queue (Kerbl et al., 2018), which waits at slots; that persistent threads need a scheduler's
// good will: Sorensen et al., "Specifying and Testing GPU Workgroup Progress Models", 2021.

struct Queue {
    tail: atomic<u32>,
    head: atomic<u32>,
    // Roots handed out.
    roots: atomic<u32>,
    // Items in the ring or in somebody's hands.
    outstanding: atomic<u32>,
    // For the record: nodes and groups looked at, nodes that a lane walked itself, and claims that came to nothing.
    nodes: atomic<u32>,
    groups: atomic<u32>,
    walked: atomic<u32>,
    idle: atomic<u32>,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> nodes: array<Node>;
@group(0) @binding(3) var<storage, read> groups: array<Group>;
@group(0) @binding(4) var<storage, read> starts: array<TraversalItem>;
@group(0) @binding(5) var<storage, read> level: Dispatch;
@group(0) @binding(6) var<storage, read_write> group_bits: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> queue: Queue;
@group(0) @binding(8) var<storage, read_write> ring: array<atomic<u32>>;

const PAYLOAD: u32 = (1u << PAYLOAD_BITS) - 1u;
const NOTHING: TraversalItem = TraversalItem(NONE, 0u);

struct Claim {
    // Of the ring.
    ticket: u32,
    tickets: u32,
    // Of the roots.
    root: u32,
    roots: u32,
}

var<workgroup> claimed: Claim;
// What a round adds to `outstanding`, and what the workgroup adds to the record.
var<workgroup> change: atomic<u32>;
var<workgroup> looked_at: array<atomic<u32>, 3>;

var<private> nodes_seen: u32;
var<private> groups_seen: u32;
var<private> nodes_walked: u32;

// What a lane that wrote `word` to a slot has replaced.
fn replaced(old: u32, word: u32) -> TraversalItem {
    let payload = old & PAYLOAD;
    if old > word || payload == 0u {
        return NOTHING;
    }
    return TraversalItem((payload - 1u) / MOST_NODES, (payload - 1u) % MOST_NODES);
}

// Puts an item into the ring, and returns what the lane has to do itself instead: that item, an older one, or nothing.
fn put(ticket: u32, item: TraversalItem) -> TraversalItem {
    if ticket >= TICKETS {
        return item;
    }
    let word = (ticket / RING) << PAYLOAD_BITS | (item.instance * MOST_NODES + item.node + 1u);
    let old = atomicMax(&ring[ticket % RING], word);
    if old > word {
        return item;
    }
    return replaced(old, word);
}

fn take(ticket: u32) -> TraversalItem {
    if ticket >= TICKETS {
        return NOTHING;
    }
    let word = (ticket / RING + 1u) << PAYLOAD_BITS;
    return replaced(atomicMax(&ring[ticket % RING], word), word);
}

// Looks at a node; the first of its children to look at, and their number. Groups become bits.
fn look_at(item: TraversalItem) -> vec2<u32> {
    nodes_seen++;
    let node = nodes[instances[item.instance].first_node + item.node];
    if !may_be_in_cut(lod_view(item.instance), node.lod_sphere, node.max_parent_error, node.min_own_error) {
        return vec2<u32>(0u);
    }
    if !footprint(instances[item.instance].screen, node.center, node.extent).seen {
        return vec2<u32>(0u);
    }
    let count = node.count & 0xffffu;
    if (node.count >> 16u) == 0u {
        return vec2<u32>(node.first, count);
    }
    groups_seen += count;
    let first_group = instances[item.instance].first_group;
    let words = instances[item.instance].group_words;
    for (var i = 0u; i < count; i++) {
        let number = node.first + i;
        let group = groups[first_group + number];
        if may_be_in_cut(lod_view(item.instance), group.lod_sphere, group.error, group.min_own_error)
            && footprint(instances[item.instance].screen, group.center, group.extent).seen {
            mark_group(words, number);
        }
    }
    return vec2<u32>(0u);
}

// Looks at a node and all below it.
fn walk(item: TraversalItem) {
    // Of each level: the next sibling, and how many are left.
    var rest: array<vec2<u32>, DEPTH>;
    rest[0] = vec2<u32>(item.node, 1u);
    var depth = 1u;
    while depth > 0u {
        let next = rest[depth - 1u];
        if next.y == 0u {
            depth--;
            continue;
        }
        rest[depth - 1u] = vec2<u32>(next.x + 1u, next.y - 1u);
        nodes_walked++;
        let children = look_at(TraversalItem(item.instance, next.x));
        if children.y > 0u && depth < DEPTH {
            rest[depth] = children;
            depth++;
        }
    }
}

// Roots for lanes that the ring has nothing for.
fn claim_roots(ticket: u32, tickets: u32) -> Claim {
    let count = min(level.count, arrayLength(&starts));
    let wanted = WIDTH - tickets;
    if wanted == 0u || atomicAdd(&queue.roots, 0u) >= count {
        return Claim(ticket, tickets, 0u, 0u);
    }
    let root = atomicAdd(&queue.roots, wanted);
    let roots = min(max(count, root) - root, wanted);
    atomicAdd(&queue.outstanding, roots);
    return Claim(ticket, tickets, root, roots);
}

// A batch of items for the workgroup; none when it is to leave.
fn claim() -> Claim {
    for (var tries = 0u; tries < PATIENCE; tries++) {
        // By additions: loads may see old values for ever.
        let tail = min(atomicAdd(&queue.tail, 0u), TICKETS);
        let head = atomicAdd(&queue.head, 0u);
        if head < tail {
            let tickets = min(tail - head, WIDTH);
            if atomicCompareExchangeWeak(&queue.head, head, head + tickets).exchanged {
                return claim_roots(head, tickets);
            }
            continue;
        }
        let roots = claim_roots(0u, 0u);
        if roots.roots > 0u || atomicAdd(&queue.outstanding, 0u) == 0u {
            return roots;
        }
        atomicAdd(&queue.idle, 1u);
    }
    let tail = min(atomicAdd(&queue.tail, 0u), TICKETS);
    let head = atomicAdd(&queue.head, 0u);
    if head < tail {
        let tickets = min(tail - head, WIDTH);
        return claim_roots(atomicAdd(&queue.head, tickets), tickets);
    }
    return claim_roots(0u, 0u);
}

@compute @workgroup_size(WIDTH)
fn main(@builtin(local_invocation_index) lane: u32) {
    if lane < 3u {
        atomicStore(&looked_at[lane], 0u);
    }
    loop {
        if lane == 0u {
            claimed = claim();
            atomicStore(&change, 0u);
        }
        let batch = workgroupUniformLoad(&claimed);
        if batch.tickets + batch.roots == 0u {
            break;
        }
        var item = NOTHING;
        if lane < batch.tickets {
            item = take(batch.ticket + lane);
        } else if lane - batch.tickets < batch.roots {
            item = starts[batch.root + lane - batch.tickets];
        }
        if item.instance != NONE {
            let children = look_at(item);
            var more = 0u;
            if children.y > 0u {
                let ticket = atomicAdd(&queue.tail, children.y);
                for (var i = 0u; i < children.y; i++) {
                    let left = put(ticket + i, TraversalItem(item.instance, children.x + i));
                    if left.instance == NONE {
                        more++;
                    } else {
                        walk(left);
                    }
                }
            }
            atomicAdd(&change, more - 1u);
        }
        workgroupBarrier();
        if lane == 0u {
            atomicAdd(&queue.outstanding, atomicLoad(&change));
        }
    }
    atomicAdd(&looked_at[0], nodes_seen);
    atomicAdd(&looked_at[1], groups_seen);
    atomicAdd(&looked_at[2], nodes_walked);
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&queue.nodes, atomicLoad(&looked_at[0]));
        atomicAdd(&queue.groups, atomicLoad(&looked_at[1]));
        atomicAdd(&queue.walked, atomicLoad(&looked_at[2]));
    }
}
