//! The pages of shadow maps that a frame looks up.

use std::cell::Cell;
use std::sync::Arc;

use rustc_hash::{FxHashMap, FxHashSet};

use crate::shadow::receiver::RelativePage;
use crate::shadow::{LightView, ShadowPage};

/// Pages that are kept at hand.
const KNOWN_PAGES: usize = 16;

/// The shadow maps of a light, as far as a frame looks them up.
#[derive(Clone, Debug)]
pub struct LightShadow {
    /// How it looks them up.
    pub view: LightView,
    /// The pages that it may want.
    pub pages: FxHashMap<RelativePage, Arc<ShadowPage>>,
    /// Those of them that were drawn for this frame.
    pub drawn: FxHashSet<RelativePage>,
}

/// The shadows of a frame: one for each of its lights, or none where a light throws no shadow.
pub type Shadows = Vec<Option<LightShadow>>;

/// Pages of a light that were looked up last: the next lookup mostly wants one of them.
#[derive(Default)]
pub struct LastPage<'a>([Cell<Option<Found<'a>>>; KNOWN_PAGES]);

/// A page, if it was marked.
type Found<'a> = (RelativePage, Option<&'a ShadowPage>);

impl<'a> LastPage<'a> {
    /// One for each of a frame's lights.
    pub fn of(shadows: Option<&'a Shadows>) -> Vec<Self> {
        shadows.map_or(&[][..], |shadows| shadows).iter().map(|_| Self::default()).collect()
    }

    /// A page of a light; `None` if it was not marked.
    #[inline(always)]
    pub fn page(&self, light: &'a LightShadow, page: RelativePage) -> Option<&'a ShadowPage> {
        // Levels that a ray climbs, and pages side by side, have places of their own.
        let place = (page.level as usize).wrapping_mul(5) ^ (page.x as usize) ^ (page.y as usize) << 1;
        let known = &self.0[place % KNOWN_PAGES];
        if let Some((known, texels)) = known.get()
            && known == page
        {
            return texels;
        }
        let texels = light.pages.get(&page).map(|texels| &**texels);
        known.set(Some((page, texels)));
        texels
    }
}
