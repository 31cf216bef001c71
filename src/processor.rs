//! What the crate is compiled for (`.cargo/config.toml`). A processor without it would end the process at some
//! instruction; [`missing`] names what it lacks before.

/// What x86-64-v2 has over x86-64, with its bit in register ECX of CPUID's leaf 1.
#[cfg(any(target_arch = "x86_64", test))]
const NEEDED: [(&str, u32); 6] =
    [("SSE3", 0), ("SSSE3", 9), ("CMPXCHG16B", 13), ("SSE4.1", 19), ("SSE4.2", 20), ("POPCNT", 23)];

#[cfg(any(target_arch = "x86_64", test))]
fn missing_of(ecx: u32) -> Vec<&'static str> {
    NEEDED.iter().filter(|(_, bit)| ecx >> bit & 1 == 0).map(|(name, _)| *name).collect()
}

/// The names of what this processor lacks of x86-64-v2; none elsewhere.
pub fn missing() -> Vec<&'static str> {
    // The standard library's question would be answered when compiling.
    #[cfg(target_arch = "x86_64")]
    return missing_of(std::arch::x86_64::__cpuid(1).ecx);
    #[cfg(not(target_arch = "x86_64"))]
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_named() {
        assert!(missing_of(u32::MAX).is_empty());
        assert_eq!(missing_of(!(1 << 19 | 1 << 23)), ["SSE4.1", "POPCNT"]);
        assert_eq!(missing_of(0).len(), NEEDED.len());
        assert!(missing().is_empty());
    }
}
