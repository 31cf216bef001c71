//! Trimming the heap. glibc keeps memory that threads free between small live blocks for later blocks of the same
//! thread. In the end that is more than the mesh takes.

/// Sources of fewer triangles are not worth a scan of the heap.
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
