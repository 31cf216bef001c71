// Random bits from numbers: src/scene/palette.rs.

fn mixed(bits: u32, word: u32) -> u32 {
    var x = (bits ^ word) * HASH_FACTOR_0;
    x ^= x >> 15u;
    x = x * HASH_FACTOR_1;
    return x ^ (x >> 13u);
}

fn hash(a: u32, b: u32, c: u32) -> u32 {
    return mixed(mixed(mixed(HASH_SEED, a), b), c);
}
