//! Several views of one submission.

use nanite_rs::config::{OUTPUTS, Output, Raster, RenderOptions};
use nanite_rs::model::UNINTERRUPTED;
use nanite_rs::render::{Frame, Renderer, Stage, ViewDesc};

use super::tolerances::same_arrays;
use super::{PARALLEL, device, funnel, on_device, options};
use crate::gpu_raster::rasterizer;
use crate::render_frames::{CAMERA, at, crowd, shoot, turned};

/// Views of several sizes, whose order changes from call to call: each frame is the one of its view alone, and follows the
/// one that its view had before.
pub fn views_by_identity(backend: &str) {
    let scene = crowd();
    let options = RenderOptions { occlusion: true, raster: Raster::Compute, ..options(1.0) };
    let mut together = Renderer::new(200, 120, backend).unwrap();
    let lens = [
        ViewDesc::new(7, CAMERA, at(0.0, 0.0, 6.0)),
        ViewDesc { size: Some((64, 48)), ..ViewDesc::new(3, PARALLEL, at(0.1, 0.0, 4.0)) },
        ViewDesc { size: Some((333, 17)), ..ViewDesc::new(u64::MAX, CAMERA, at(0.0, 1.0, 9.0)) },
    ];
    let size = |view: &ViewDesc| view.size.unwrap_or((200, 120));
    let mut apart = lens.map(|view| Renderer::new(size(&view).0, size(&view).1, backend).unwrap());
    for order in [[0, 1, 2], [2, 0, 1], [1, 2, 0], [2, 1, 0]] {
        let views = order.map(|k| lens[k]);
        let frames = together.render_views(&scene, &views, &options, UNINTERRUPTED).unwrap();
        for ((frame, view), k) in frames.iter().zip(&views).zip(order) {
            assert_eq!((frame.width(), frame.height()), size(view));
            let alone = apart[k].render(&scene, &view.camera, &view.pose, &options).unwrap();
            assert!(frame.words().unwrap() == alone.words().unwrap());
            for pass in [1, 2] {
                let stages = [Stage::NodeCull, Stage::ClusterCull];
                let counts = |frame: &Frame| stages.map(|stage| funnel(frame, stage, pass));
                assert_eq!(counts(frame), counts(&alone), "view {} in pass {pass}", view.id);
            }
        }
    }
    let refused = |views: &[ViewDesc], what: &str| {
        let error =
            Renderer::new(200, 120, backend).unwrap().render_views(&scene, views, &options, UNINTERRUPTED);
        let message = error.unwrap_err().to_string();
        assert!(message.contains(what), "{message}");
    };
    refused(&[lens[0], lens[1], lens[0]], "views: two of them have the id 7");
    refused(&[ViewDesc { size: Some((0, 4)), ..lens[0] }], "width: must be between 1 and");
}

#[test]
fn views_of_any_size_share_a_submission() {
    let Some(_) = device("views_of_any_size_share_a_submission") else { return };
    views_by_identity("gpu");
}

#[test]
fn several_views_of_one_submission_are_as_alone() {
    let Some(_) = device("several_views_of_one_submission_are_as_alone") else { return };
    let scene = crowd();
    let size = (200, 120);
    let options = RenderOptions {
        occlusion: true,
        outputs: OUTPUTS.into_iter().collect(),
        device_outputs: Some(true),
        ..options(1.0)
    };
    let mut together = Renderer::new(size.0, size.1, "gpu").unwrap();
    let mut on_cpu = Renderer::new(size.0, size.1, "cpu").unwrap();
    assert!(together.render_views(&scene, &[], &options, UNINTERRUPTED).unwrap().is_empty());
    // Their number changes, and so do their eyes; one of them looks away from everything.
    for (step, count) in [(0.0, 3), (0.1, 3), (0.2, 5), (0.3, 1), (0.4, 4)] {
        let all = [
            (CAMERA, at(step, 0.0, 6.0)),
            (PARALLEL, at(0.1, step, 4.0)),
            (CAMERA, turned(at(0.0, 0.0, 6.0), 3.0)),
            (CAMERA, at(0.0, 1.0, 9.0 + 10.0 * step)),
            (PARALLEL, at(-1.0, 0.0, 5.0)),
        ];
        let views = &all[..count];
        let frames =
            together.render_views(&scene, &ViewDesc::numbered(views), &options, UNINTERRUPTED).unwrap();
        let theirs =
            on_cpu.render_views(&scene, &ViewDesc::numbered(views), &options, UNINTERRUPTED).unwrap();
        assert_eq!((frames.len(), theirs.len()), (count, count));
        for ((frame, their), (camera, pose)) in frames.iter().zip(&theirs).zip(views) {
            // Words number what was drawn, of which what is hidden depends on the frame before.
            let alone = shoot(&scene, camera, pose, size, &options);
            assert!(their.color().unwrap() == alone.color().unwrap());
            for output in [Output::Depth, Output::InstanceId, Output::ClusterId, Output::TriangleId] {
                let expected = alone.array(output).unwrap();
                assert!(frame.array(output).unwrap() == expected, "{}", output.name());
                assert!(their.array(output).unwrap() == expected, "{}", output.name());
            }
            assert_eq!(frame.stats.covered_pixels, alone.stats.covered_pixels);
            assert_eq!(frame.stats.source_triangles > 0, alone.stats.source_triangles > 0);
        }
        // Bit for bit what each of them draws by itself where nothing is left out.
        let whole = RenderOptions { occlusion: false, ..options.clone() };
        let frames =
            together.render_views(&scene, &ViewDesc::numbered(views), &whole, UNINTERRUPTED).unwrap();
        for (frame, (camera, pose)) in frames.iter().zip(views) {
            same_arrays(frame, &on_device(&scene, camera, pose, size, &whole));
            assert!(frame.words().unwrap() == shoot(&scene, camera, pose, size, &whole).words().unwrap());
        }
    }
}

#[test]
fn the_devices_rasterizer_draws_each_of_several_views() {
    let Some(_) = rasterizer("the_devices_rasterizer_draws_each_of_several_views") else { return };
    let (scene, size) = (crowd(), (200, 120));
    let views = [(CAMERA, at(0.0, 0.0, 6.0)), (PARALLEL, at(0.1, 0.2, 4.0))];
    let hybrid = RenderOptions { raster: Raster::Hybrid, occlusion: true, ..options(1.0) };
    let mut together = Renderer::new(size.0, size.1, "gpu").unwrap();
    let frames = together.render_views(&scene, &ViewDesc::numbered(&views), &hybrid, UNINTERRUPTED).unwrap();
    for (frame, (camera, pose)) in frames.iter().zip(&views) {
        let alone = shoot(&scene, camera, pose, size, &hybrid);
        let covered = |frame: &Frame| frame.words().unwrap().iter().map(|w| *w != 0).collect::<Vec<_>>();
        assert!(covered(frame) == covered(&alone));
    }
}
