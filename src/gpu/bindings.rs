//! What kernels bind, by name: a struct for each list of buffers, whose fields are named as the kernel declares them. So two
//! buffers of one type cannot change places unnoticed. `tests/rust/shader_validation.rs` compares names and order with what
//! naga reflects of each kernel.

use wgpu::Buffer;

/// Buffers in the order of their bindings.
pub(super) trait Bindings<'a> {
    /// Their names in the kernel.
    const NAMES: &'static [&'static str];

    /// The buffers.
    fn buffers(&self) -> Vec<&'a Buffer>;
}

/// Declares a struct of bindings.
macro_rules! bindings {
    ($(#[$doc:meta])* $name:ident { $($field:ident),* $(,)? }) => {
        $(#[$doc])*
        pub(super) struct $name<'a> {
            $(pub(super) $field: &'a wgpu::Buffer,)*
        }

        impl<'a> $crate::gpu::bindings::Bindings<'a> for $name<'a> {
            const NAMES: &'static [&'static str] = &[$(stringify!($field)),*];

            fn buffers(&self) -> Vec<&'a wgpu::Buffer> {
                vec![$(self.$field),*]
            }
        }
    };
}

pub(super) use bindings;

bindings! {
    /// What all rasterizers bind.
    RasterBindings {
        view, instances, page_offsets, pages, visible, numbers, draws, words, counters, pages_1, pages_2, pages_3,
    }
}

bindings! {
    /// What kernels bind that make an array of a finished visibility buffer.
    SurfaceBindings {
        view, instances, page_offsets, pages, pages_1, pages_2, pages_3, visible, instance_materials, words, out,
    }
}

bindings! {
    /// What `count_bits` binds.
    CountBits { bits, blocks, sums }
}

bindings! {
    /// What `scan_blocks` binds.
    ScanBlocks { blocks, sums }
}
