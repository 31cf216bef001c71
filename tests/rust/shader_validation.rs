//! Shaders without a device: every one is valid, binds no more than devices allow, and lays out structs as Rust does.

use std::mem::{offset_of, size_of};

use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, Module, ShaderStage, StorageAccess, TypeInner};
use nanite_rs::gpu::context::{STORAGE_BUFFERS, WORKGROUP_BYTES};
use nanite_rs::gpu::kernels::{Access, CullPass, Kernel, cluster_cull, kernels};
use nanite_rs::gpu_types::{
    CandidateGroup, Counters, Dispatch, DrawArgs, Group, Instance, InstanceMaterial, InstanceTransform,
    Light, Lighting, Marks, Material, Node, PairLists, ShadowLight, Texture, TraversalItem, View,
    VisibleCluster,
};

fn parse(kernel: Kernel) -> Module {
    parse_for(kernel, None)
}

fn parse_for(kernel: Kernel, array_bits: Option<u32>) -> Module {
    let source = kernel.source(array_bits);
    naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|error| panic!("{kernel:?}: {}", error.emit_to_string(&source)))
}

/// What every device with and without 64-bit atomics must accept.
fn capabilities(kernel: Kernel) -> Capabilities {
    match kernel.variants.contains(&Some("shared/words_64")) {
        true => Capabilities::SHADER_INT64 | Capabilities::SHADER_INT64_ATOMIC_MIN_MAX,
        false => Capabilities::empty(),
    }
}

#[test]
fn every_kernel_is_valid() {
    for kernel in kernels() {
        let expected = match kernel.draws {
            true => &[("corner", ShaderStage::Vertex), ("pixel", ShaderStage::Fragment)][..],
            false => &[("main", ShaderStage::Compute)],
        };
        for array_bits in [None, Some(25)] {
            let module = parse_for(kernel, array_bits);
            let mut validator = Validator::new(ValidationFlags::all(), capabilities(kernel));
            if let Err(error) = validator.validate(&module) {
                panic!("{kernel:?}: {}", error.emit_to_string(&kernel.source(array_bits)));
            }
            let entries = module.entry_points.iter().map(|entry| (entry.name.as_str(), entry.stage));
            assert_eq!(entries.collect::<Vec<_>>(), expected);
        }
    }
}

#[test]
fn shared_files_find_what_they_need() {
    for kernel in kernels() {
        assert_eq!(kernel.undeclared(), Vec::<String>::new(), "{kernel:?}");
    }
}

/// How a variable of a module is bound.
fn access(space: AddressSpace) -> Option<Access> {
    match space {
        AddressSpace::Uniform => Some(Access::Uniform),
        AddressSpace::Storage { access } if access.contains(StorageAccess::STORE) => Some(Access::Write),
        AddressSpace::Storage { .. } => Some(Access::Read),
        _ => None,
    }
}

#[test]
fn kernels_bind_what_they_declare() {
    for kernel in kernels() {
        let module = parse(kernel);
        let bound = module.global_variables.iter().filter_map(|(_, variable)| {
            let binding = variable.binding.as_ref()?;
            Some(((binding.group, binding.binding), variable.name.clone()?, access(variable.space)?))
        });
        let mut bound: Vec<_> = bound.collect();
        bound.sort_by_key(|(place, ..)| *place);
        let declared = (0..).zip(kernel.bound());
        let declared = declared.map(|(number, own)| ((0, number), own.name.to_owned(), own.access));
        assert_eq!(bound, declared.collect::<Vec<_>>(), "{kernel:?}");
    }
}

#[test]
fn kernels_bind_no_more_than_devices_allow() {
    for kernel in kernels() {
        let module = parse(kernel);
        let mut storage = 0;
        let mut workgroup = 0;
        let mut bindings = Vec::new();
        for (_, variable) in module.global_variables.iter() {
            match variable.space {
                AddressSpace::Storage { .. } => storage += 1,
                AddressSpace::WorkGroup => workgroup += module.types[variable.ty].inner.size(module.to_ctx()),
                _ => {}
            }
            bindings.extend(variable.binding.map(|b| (b.group, b.binding)));
        }
        bindings.sort_unstable();
        // Buffers are bound by the order of a list.
        assert_eq!(bindings, (0..bindings.len() as u32).map(|i| (0, i)).collect::<Vec<_>>(), "{kernel:?}");
        assert!(storage <= STORAGE_BUFFERS, "{kernel:?}: {storage} storage buffers");
        assert!(workgroup <= WORKGROUP_BYTES, "{kernel:?}: {workgroup} bytes of workgroup memory");
    }
}

/// Members of a struct with their offsets, and its size.
fn layout(module: &Module, name: &str) -> Option<(Vec<(String, u32)>, u32)> {
    module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).map(|(_, ty)| match &ty.inner {
        TypeInner::Struct { members, span } => {
            let members = members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset));
            (members.collect(), *span)
        }
        other => panic!("{name} is {other:?}"),
    })
}

macro_rules! fields {
    ($type:ident: $($field:ident),+) => {
        (stringify!($type), size_of::<$type>(), vec![$((stringify!($field), offset_of!($type, $field))),+])
    };
}

#[test]
fn structs_lie_in_wgsl_as_in_rust() {
    let module = parse(cluster_cull(CullPass::Second));
    let mut structs = vec![
        fields!(View: width, height, orthographic, near, far, far_key, tau, instances, zero, levels, history,
            group_words, pyramid, rotate, forward, lod_focal, low, lod_near, focal, center, inverse_focal, mirrored,
            viewport, occluders, depth_only, lod_widest, two_passes, skew, first_word, unused_b, unused_c),
        fields!(Instance: screen, before, object_to_eye, center, lod_scale, extent, lod_focal, eye, near_key, first_node,
            first_group, first_page, group_words, double_sided, mirrored, alpha_tested, rounding, rect),
        fields!(Node: center, first, extent, count, lod_sphere, max_parent_error, min_own_error, unused),
        fields!(Group: lod_sphere, center, error, extent, min_own_error, first, count, unused),
        fields!(TraversalItem: instance, node),
        fields!(CandidateGroup: instance, first, count, before, group),
        fields!(VisibleCluster: instance, cluster, large),
        fields!(PairLists: room, unused_a, unused_b, unused_c),
        fields!(Dispatch: x, y, z, count, visited, unhidden, unused),
        fields!(Counters: visited_clusters, drawn_small, drawn_large, visible, occluded, pyramid, triangles_small,
            triangles_large, drawn_hardware, covered, tiles),
        fields!(InstanceTransform: linear, inverse, center, lod_scale, extent, first_node, first_group, first_page,
            group_words, double_sided, mirrored, visible, alpha_tested, rounding),
        fields!(Marks: large, old, first, clipped),
        fields!(DrawArgs: vertices, instances, first_vertex, first_instance),
        fields!(InstanceMaterial: normal, emissive, metallic, roughness, flags, first_material, last_material),
        fields!(Texture: rows, start, levels, flags, anisotropy),
        fields!(Material: base, alpha, emissive, metallic, roughness, normal_scale, occlusion_strength, alpha_cutoff,
            flags, unused_a, unused_b, unused_c, textures),
        fields!(Light: vector, point, radiance, inverse_range, direction, cone_scale, cone_offset, unused),
        fields!(ShadowLight: axes, kind, first, coarser, orthographic, tangent, near, reach_squared, focal, threshold,
            radius, inverse_radius, top, samples, points, anchors, table, mask, unused_a, unused_b, unused_c),
        fields!(Lighting: ambient, lights, behind, background, power, shading, environment_visible, intensity,
            to_map, grids),
    ];
    // The same structs with atomic members.
    for (name, of) in [("DispatchArgsOut", "Dispatch"), ("DrawArgsOut", "DrawArgs")] {
        let (_, size, members) = structs.iter().find(|s| s.0 == of).unwrap().clone();
        structs.push((name, size, members));
    }
    for (name, size, expected) in structs {
        let (members, span) = layout(&module, name).unwrap_or_else(|| panic!("no struct {name}"));
        let members: Vec<(&str, usize)> = members.iter().map(|(n, o)| (n.as_str(), *o as usize)).collect();
        assert_eq!((members, span as usize), (expected, size), "{name}");
    }
}
