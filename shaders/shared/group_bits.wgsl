// Bits of groups. Behind them lies a summary bit for each word that is not zero.
// Needs: view, group_bits.

fn is_marked(first_word: u32, number: u32) -> bool {
    return (atomicLoad(&group_bits[first_word + number / 32u]) >> (number % 32u) & 1u) != 0u;
}

fn mark_group(first_word: u32, number: u32) {
    let word = first_word + number / 32u;
    if atomicOr(&group_bits[word], 1u << (number % 32u)) == 0u {
        atomicOr(&group_bits[view.group_words + word / 32u], 1u << (word % 32u));
    }
}
