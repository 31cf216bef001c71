//! Freed memory goes back to the system. glibc keeps what threads free between small blocks that live on, for later
//! blocks of the same thread that may never come: in the end more than the mesh takes.

/// Triangles of a source below which that is not worth a look at all the memory of the process.
const WORTHWHILE: usize = 1 << 18;

/// Returns free pages to the system, where the source had many triangles and the allocator keeps pages.
pub fn trim_heap(source_faces: usize) {
    if source_faces < WORTHWHILE {
        return;
    }
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        unsafe extern "C" {
            fn malloc_trim(keep: usize) -> std::ffi::c_int;
        }
        // SAFETY: it takes no pointer, touches free blocks alone, and may be called by any thread at any time.
        unsafe { malloc_trim(0) };
    }
}
