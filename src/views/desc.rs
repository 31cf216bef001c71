//! What is rendered: views, each with a stable identity by which what it keeps between frames is found.

use crate::config::{Outputs, RenderOptions};
use crate::error::{Error, Result};
use crate::scene::camera::MAX_VIEWPORT;
use crate::scene::{Camera, View};

/// What a view is drawn for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewKind {
    /// Everything that can be made of a visibility buffer.
    Color,
    /// Depth and nothing else, at half the memory.
    DepthOnly,
}

/// A view of a scene. What is `None` is as in the options of the call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewDesc {
    /// Its identity: frames of equal ones follow each other, whatever else is drawn with them.
    pub id: u64,
    /// The camera.
    pub camera: Camera,
    /// Camera to world.
    pub pose: [[f64; 4]; 4],
    /// Width and height, pixels; `None` for those of the renderer.
    pub size: Option<(u32, u32)>,
    /// Error of what is drawn at most, pixels.
    pub pixel_error: Option<f32>,
    /// Arrays made with the frame.
    pub outputs: Option<Outputs>,
    /// What it is drawn for.
    pub kind: Option<ViewKind>,
}

impl ViewDesc {
    /// A view of the renderer's size, drawn as the options say.
    pub fn new(id: u64, camera: Camera, pose: [[f64; 4]; 4]) -> Self {
        Self { id, camera, pose, size: None, pixel_error: None, outputs: None, kind: None }
    }

    /// Views of the renderer's size, numbered from 0.
    pub fn numbered(views: &[(Camera, [[f64; 4]; 4])]) -> Vec<Self> {
        (0..).zip(views).map(|(id, (camera, pose))| Self::new(id, *camera, *pose)).collect()
    }

    /// The options of a call for this view.
    pub(crate) fn options(&self, of_call: &RenderOptions) -> RenderOptions {
        let mut options = of_call.clone();
        options.pixel_error = self.pixel_error.unwrap_or(options.pixel_error);
        options.depth_only = self.kind.map_or(options.depth_only, |kind| kind == ViewKind::DepthOnly);
        // A view that becomes one of depth alone cannot make the arrays of the others.
        let of_call = match options.depth_only && !of_call.depth_only {
            true => RenderOptions::depth_only().outputs,
            false => options.outputs,
        };
        options.outputs = self.outputs.unwrap_or(of_call);
        options
    }

    /// The view, on an image of `size` where it has none of its own.
    pub(crate) fn view(&self, size: (u32, u32)) -> Result<View> {
        let (width, height) = self.size.unwrap_or(size);
        check_size(width, height)?;
        self.camera.view(&self.pose, width, height)
    }
}

/// Whether an image may have such a size.
pub(crate) fn check_size(width: u32, height: u32) -> Result<()> {
    for (name, value) in [("width", width), ("height", height)] {
        if !(1..=MAX_VIEWPORT).contains(&value) {
            return Err(Error::argument(name, format!("must be between 1 and {MAX_VIEWPORT}, not {value}")));
        }
    }
    Ok(())
}

/// Whether all views have identities of their own.
pub(crate) fn check_ids(views: &[ViewDesc]) -> Result<()> {
    let mut ids: Vec<u64> = views.iter().map(|view| view.id).collect();
    ids.sort_unstable();
    match ids.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(Error::argument("views", format!("two of them have the id {}", pair[0]))),
        None => Ok(()),
    }
}
