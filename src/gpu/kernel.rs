//! What a kernel is: a file of WGSL, the constants that tell it from others of that file, and the buffers that it binds, by
//! name. Each stage declares its own in its file; `kernels` lists them all. `tests/rust/shader_validation.rs` compares what
//! is declared here with what naga reflects of the source.

use std::hash::{Hash, Hasher};
use std::sync::Arc;

use wgpu::{BindingResource, Buffer, BufferBinding, BufferSize, ShaderStages};

/// Lanes of a workgroup where each entry is looked at by itself.
pub const WIDTH: u32 = 64;
/// Workgroups that every device allows along a dimension.
pub const MAX_WORKGROUPS: u32 = 65_535;

/// How a kernel binds a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Access {
    /// A uniform.
    Uniform,
    /// Storage that it reads.
    Read,
    /// Storage that it writes, and may read.
    Write,
}

/// A buffer that a kernel binds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Binding {
    /// Its name in the source.
    pub name: &'static str,
    /// How it is bound.
    pub access: Access,
}

/// What a kernel binds, in the order of the numbers: lists one after the other.
pub type BindingLists = &'static [&'static [Binding]];

/// A constant of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Constant {
    /// No constant.
    None,
    /// A truth value by its name.
    Flag(&'static str, bool),
    /// A number by its name.
    Number(&'static str, u32),
}

/// Constants that tell a kernel from others of its file, at most, and shared files.
const MAX_CONSTANTS: usize = 4;
const MAX_VARIANTS: usize = 3;

/// See the module's documentation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernel {
    /// Name of its file in `shaders/`.
    pub file: &'static str,
    /// Shared files that its own does not name, since it takes one of several.
    pub variants: [Option<&'static str>; MAX_VARIANTS],
    /// What its source declares for it.
    pub constants: [Constant; MAX_CONSTANTS],
    /// What it binds.
    pub bindings: BindingLists,
    /// It draws, by a vertex and a fragment shader.
    pub draws: bool,
}

/// Of what tells kernels apart.
impl Hash for Kernel {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.file, self.variants, self.constants).hash(state);
    }
}

impl Kernel {
    /// A kernel of a file that has no other.
    pub(super) const fn new(file: &'static str, bindings: BindingLists) -> Self {
        let (variants, constants) = ([None; MAX_VARIANTS], [Constant::None; MAX_CONSTANTS]);
        Self { file, variants, constants, bindings, draws: false }
    }

    /// With shared files.
    pub(super) const fn with<const N: usize>(mut self, variants: [&'static str; N]) -> Self {
        let mut k = 0;
        while k < N {
            self.variants[k] = Some(variants[k]);
            k += 1;
        }
        self
    }

    /// With constants.
    pub(super) const fn constants<const N: usize>(mut self, constants: [Constant; N]) -> Self {
        let mut k = 0;
        while k < N {
            self.constants[k] = constants[k];
            k += 1;
        }
        self
    }

    /// Of a pass of occlusion culling.
    pub(super) const fn of(self, cull_pass: CullPass) -> Self {
        self.constants([cull_pass.constant()])
    }

    /// All that it binds.
    pub fn bound(self) -> impl Iterator<Item = Binding> {
        self.bindings.iter().copied().flatten().copied()
    }

    /// Whether it reads pages, so that it depends on how many arrays they lie in.
    pub fn reads_pages(self) -> bool {
        self.bound().any(|binding| binding.name == "pages")
    }

    /// The shaders that bind.
    pub(super) fn visibility(self) -> ShaderStages {
        if self.draws { ShaderStages::VERTEX_FRAGMENT } else { ShaderStages::COMPUTE }
    }
}

/// A buffer, or the part of one, that a kernel binds.
#[derive(Clone, Copy, Debug)]
pub struct BoundBuffer<'a> {
    /// The buffer.
    pub buffer: &'a Buffer,
    /// Bytes before the part.
    pub offset: u64,
    /// Bytes of the part; none for all behind `offset`.
    pub size: Option<BufferSize>,
}

impl<'a> From<&'a Buffer> for BoundBuffer<'a> {
    fn from(buffer: &'a Buffer) -> Self {
        Self { buffer, offset: 0, size: None }
    }
}

impl<'a> From<&'a Arc<Buffer>> for BoundBuffer<'a> {
    fn from(buffer: &'a Arc<Buffer>) -> Self {
        Self::from(&**buffer)
    }
}

impl<'a> From<BoundBuffer<'a>> for BindingResource<'a> {
    fn from(BoundBuffer { buffer, offset, size }: BoundBuffer<'a>) -> Self {
        Self::Buffer(BufferBinding { buffer, offset, size })
    }
}

/// Buffers in the order of their numbers.
pub(super) trait Bindings<'a> {
    /// What a kernel declares.
    const BINDINGS: &'static [Binding];

    /// The buffers.
    fn buffers(&self) -> Vec<BoundBuffer<'a>>;
}

/// Declares a struct of buffers, whose fields are named as the kernel declares them, so that two buffers of one type cannot
/// change places unnoticed.
macro_rules! bindings {
    ($(#[$doc:meta])* $name:ident { $($field:ident: $access:ident),* $(,)? }) => {
        $(#[$doc])*
        pub(super) struct $name<'a> {
            $(pub(super) $field: $crate::gpu::kernel::BoundBuffer<'a>,)*
        }

        impl<'a> $crate::gpu::kernel::Bindings<'a> for $name<'a> {
            const BINDINGS: &'static [$crate::gpu::kernel::Binding] = &[$($crate::gpu::kernel::Binding {
                name: stringify!($field),
                access: $crate::gpu::kernel::Access::$access,
            }),*];

            fn buffers(&self) -> Vec<$crate::gpu::kernel::BoundBuffer<'a>> {
                vec![$(self.$field),*]
            }
        }
    };
}

/// Makes such a struct: of whole buffers and of parts.
macro_rules! bind {
    ($name:ident { $($field:ident: $buffer:expr),* $(,)? }) => {
        $name { $($field: $crate::gpu::kernel::BoundBuffer::from($buffer)),* }
    };
}

pub(super) use {bind, bindings};

/// Which of the two passes of occlusion culling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CullPass {
    /// What an earlier frame does not hide, or of what it drew; without occlusion, everything.
    First,
    /// What the first deferred, by its depth pyramid.
    Second,
}

impl CullPass {
    /// Both, in order.
    pub const BOTH: [Self; 2] = [Self::First, Self::Second];

    pub(super) const fn constant(self) -> Constant {
        Constant::Flag("SECOND", matches!(self, Self::Second))
    }
}
