//! What is rendered: views, each with a stable identity by which what it keeps between frames is found.

use crate::error::{Error, Result};
use crate::scene::camera::MAX_VIEWPORT;
use crate::scene::{Camera, View};

/// A view of a scene.
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
}

impl ViewDesc {
    /// A view of the renderer's size.
    pub fn new(id: u64, camera: Camera, pose: [[f64; 4]; 4]) -> Self {
        Self { id, camera, pose, size: None }
    }

    /// Views of the renderer's size, numbered from 0.
    pub fn numbered(views: &[(Camera, [[f64; 4]; 4])]) -> Vec<Self> {
        (0..).zip(views).map(|(id, (camera, pose))| Self::new(id, *camera, *pose)).collect()
    }

    /// The view, on an image of `size` where it has none of its own.
    pub(super) fn view(&self, size: (u32, u32)) -> Result<View> {
        let (width, height) = self.size.unwrap_or(size);
        check_size(width, height)?;
        self.camera.view(&self.pose, width, height)
    }
}

/// Whether an image may have such a size.
pub(super) fn check_size(width: u32, height: u32) -> Result<()> {
    for (name, value) in [("width", width), ("height", height)] {
        if !(1..=MAX_VIEWPORT).contains(&value) {
            return Err(Error::argument(name, format!("must be between 1 and {MAX_VIEWPORT}, not {value}")));
        }
    }
    Ok(())
}

/// Whether all views have identities of their own.
pub(super) fn check_ids(views: &[ViewDesc]) -> Result<()> {
    let mut ids: Vec<u64> = views.iter().map(|view| view.id).collect();
    ids.sort_unstable();
    match ids.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(Error::argument("views", format!("two of them have the id {}", pair[0]))),
        None => Ok(()),
    }
}
