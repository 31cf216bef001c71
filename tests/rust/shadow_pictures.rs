//! Pictures that a device draws, shadowed there by pages that the CPU drew: shares and light are the CPU's.

use nanite_rs::config::{Output, RenderOptions, Shadows};
use nanite_rs::gpu::Context;
use nanite_rs::gpu::kernels::{BoundBuffer, Ibl, Kernel, MaterialKind, SHADOW_TEST, Shadowing, WIDTH, shade};
use nanite_rs::gpu::shadow_table::shadow_table;
use nanite_rs::gpu::wgpu::{Buffer, BufferUsages, CommandEncoderDescriptor, ComputePassDescriptor};
use nanite_rs::limits::SHADOW_SLOT_WORDS;
use nanite_rs::render::{Frame, Renderer, shadow_map_entries};
use nanite_rs::scene::{Camera, InstanceHandle, Projection};

use crate::gpu_parity::device;
use crate::render_frames::{CAMERA, at, shoot};
use crate::shadows::{RADII, lit_crowd};

const SIZE: (u32, u32) = (160, 120);

/// Of what kernels bind that read a visibility buffer, the array that they write.
const OUT: usize = 10;

/// Runs a kernel of the last picture, which writes so many words for each of its pixels.
fn run(
    context: &Context,
    (kernel, split): (Kernel, bool),
    bound: &[BoundBuffer<'_>],
    out: &Buffer,
    words: usize,
) -> Vec<f32> {
    let bytes = (words * size_of::<f32>()) as u64;
    let read = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
    let staging = context.buffer("shares", bytes, read).unwrap();
    let mut encoder = context.device().create_command_encoder(&CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
        pass.set_pipeline(&context.pipeline(kernel, split));
        pass.set_bind_group(0, &context.bind(kernel, bound), &[]);
        pass.dispatch_workgroups((SIZE.0 * SIZE.1).div_ceil(4 * WIDTH), 1, 1);
    }
    encoder.copy_buffer_to_buffer(out, 0, &staging, 0, bytes);
    let mut found = Vec::new();
    context.submit(encoder, &staging, bytes, |bytes| found = bytemuck::pod_collect_to_vec(bytes)).unwrap();
    found
}

/// The shadow maps of a frame as a device has them: table and pages.
fn maps(frame: &Frame) -> (Vec<[u32; 4]>, Vec<u32>) {
    let (mut pool, mut lights) = (Vec::new(), Vec::new());
    for light in frame.shadow_maps().unwrap() {
        let mut pages = Vec::new();
        for (page, texels) in light.iter().flat_map(|light| &light.pages) {
            pages.push((*page, (pool.len() / SHADOW_SLOT_WORDS) as u32));
            pool.extend(texels.words());
        }
        lights.push(light.as_ref().map(|light| shadow_map_entries(&light.view, pages)));
    }
    (shadow_table(&lights), pool)
}

/// How many of two arrays differ by more than a part of themselves and of what is small.
fn differing(ours: &[f32], theirs: &[f32]) -> usize {
    assert_eq!(ours.len(), theirs.len());
    ours.iter().zip(theirs).filter(|(a, b)| (*a - *b).abs() > 2e-3 * a.max(**b) + 1e-4).count()
}

#[test]
fn pictures_are_shadowed_as_on_the_cpu() {
    let Some(context) = device("pictures_are_shadowed_as_on_the_cpu") else { return };
    let parallel =
        Camera { projection: Projection::Orthographic { xmag: None, ymag: 3.0 }, znear: 0.05, zfar: None };
    for (radius, camera) in RADII.into_iter().flat_map(|radius| [(radius, CAMERA), (radius, parallel)]) {
        let mut scene = lit_crowd(radius);
        // On one instance no shadow falls.
        let first = scene.instances().handles().map(InstanceHandle).next().unwrap();
        scene.set_shadows(first, true, false).unwrap();
        let pose = at(0.3, 1.0, 9.0);
        let outputs = [Output::Linear].into_iter().collect();
        let options = RenderOptions { outputs, shadows: Shadows::Virtual, ..RenderOptions::default() };
        let expected = shoot(&scene, &camera, &pose, SIZE, &options);
        let mut renderer = Renderer::new(SIZE.0, SIZE.1, "gpu").unwrap();
        let bare = RenderOptions { shadows: Shadows::Off, device_outputs: Some(true), ..options };
        renderer.render(&scene, &camera, &pose, &bare).unwrap();
        let (unshadowed, mut bound, split) =
            renderer.on_device().unwrap().shading(0, Output::Linear).unwrap();
        assert_eq!(unshadowed, shade(Output::Linear, MaterialKind::Plain, Ibl::Off, Shadowing::Off));
        let (table, pool) = maps(&expected);
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let buffer = |words: &[u32]| {
            let buffer = context.buffer("shadows", size_of_val(words) as u64, storage).unwrap();
            context.queue().write_buffer(&buffer, 0, bytemuck::cast_slice(words));
            buffer
        };
        let (table, pool) = (buffer(table.as_flattened()), buffer(&pool));
        let shares = expected.shadow().unwrap();
        let out = context.buffer("shares", size_of_val(&shares[..]) as u64, storage).unwrap();
        bound[OUT] = BoundBuffer::from(&out);
        let shadows = [&table, &pool].map(BoundBuffer::from);
        let tested = [&bound[..=OUT], &shadows].concat();
        let found = run(&context, (SHADOW_TEST, split), &tested, &out, shares.len());
        let off = differing(&found, &shares);
        let light = expected.linear().unwrap();
        let out = context.buffer("light", size_of_val(&light[..]) as u64, storage).unwrap();
        bound[OUT] = BoundBuffer::from(&out);
        bound.extend(shadows);
        let shadowed = shade(Output::Linear, MaterialKind::Plain, Ibl::Off, Shadowing::On);
        let found = run(&context, (shadowed, split), &bound, &out, light.len());
        let changed = differing(&found, &light);
        let dark = shares.iter().filter(|share| **share < 1.0).count();
        println!(
            "radius {radius}: {off} of {} shares, {dark} below 1; {changed} of {} colours",
            shares.len(),
            light.len()
        );
        assert!(dark > 5000, "{dark}");
        // Receivers are rounded as surfaces are, and some lie on edges of texels.
        assert!(2000 * off <= shares.len() && 1000 * changed <= light.len(), "{off} and {changed}");
    }
}
