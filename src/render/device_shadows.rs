//! Shadows of frames on a device: it draws pages, which stay there; what the CPU makes of a frame later reads them.

use std::sync::{Arc, OnceLock};

use rustc_hash::FxHashSet;

use super::device::view_record;
use super::renderer::{FrameContext, Rastered};
use super::shadow_records::shadow_map_entries;
use super::shadows::{Casters, FrameLight, FrameLights, Host, Painted, Painter, on_host};
use crate::cpu::shadow_pages::Shadows;
use crate::error::Result;
use crate::gpu::shadow_table::shadow_table;
use crate::gpu::{DevicePage, DeviceRenderer, ShadowBlock};
use crate::gpu_types;
use crate::scene::View;
use crate::scene::placement::Eye;
use crate::shadow::{Grid, LightView, PageKey, ShadowCache, ShadowPage};
use crate::views::Screen;

/// A device.
pub(super) struct OnDevice<'a>(pub(super) &'a mut DeviceRenderer);

impl Painter for OnDevice<'_> {
    type Page = Arc<DevicePage>;

    fn mark(
        &mut self,
        frame_context: &FrameContext<'_>,
        rastered: &Rastered,
        lights: &[LightView],
    ) -> Result<FxHashSet<PageKey>> {
        let entries: Vec<_> =
            lights.iter().map(|light| Some(shadow_map_entries(light, std::iter::empty()))).collect();
        let found = self.0.mark_shadows(frame_context.id, &shadow_table(&entries), lights.len())?;
        let Some(found) = found else { return Host::default().mark(frame_context, rastered, lights) };
        let pages = lights.iter().zip(found).flat_map(|(light, columns)| {
            let columns = columns.iter().map(|column| (light.column(column.bits), column.heights));
            light.pages(columns.collect())
        });
        Ok(pages.collect())
    }

    fn triangles(page: &Self::Page) -> u32 {
        page.triangles()
    }

    fn most(&self) -> usize {
        self.0.most_shadow_pages()
    }

    fn paint(
        &mut self,
        pages: &[PageKey],
        casters: &Casters<'_>,
        held: &ShadowCache<Self::Page>,
        most: usize,
    ) -> Result<Painted<Self::Page>> {
        let Casters { maps, resident, occlusion, .. } = *casters;
        let mut first = 0;
        let block = |pages: &[PageKey]| {
            let (block, map) = (pages[0].block(), &maps[&pages[0].light]);
            let grid = Grid::new(&block, pages, first);
            first += pages.len() as u32;
            let record = |view: &View| view_of(view, PageKey::threshold(block.0.tau));
            ShadowBlock {
                view: record(&map.block_view(&block)),
                grid: grid.words().to_vec(),
                pages: pages.iter().map(|page| record(&map.page_view(page))).collect(),
            }
        };
        let mut blocks: Vec<ShadowBlock> = pages.chunk_by(|a, b| a.block() == b.block()).map(block).collect();
        let drawn = self.0.draw_shadows(&mut blocks, most, &held.held(), occlusion, resident)?;
        // Which pages what is missing touches is not told.
        let whole = !drawn.lacks;
        Ok(Painted {
            pages: pages.iter().zip(drawn.pages).map(|(key, page)| (*key, page, whole)).collect(),
            clusters: drawn.clusters,
            culled_instances: 0,
            culled_clusters: drawn.culled_clusters,
            needs: drawn.needs,
        })
    }
}

/// A device that marks pages, and the CPU that draws them: to find out which of them goes wrong.
pub(super) struct MarkedOnDevice<'a>(pub(super) OnDevice<'a>);

impl Painter for MarkedOnDevice<'_> {
    type Page = Arc<ShadowPage>;

    fn mark(
        &mut self,
        frame_context: &FrameContext<'_>,
        rastered: &Rastered,
        lights: &[LightView],
    ) -> Result<FxHashSet<PageKey>> {
        self.0.mark(frame_context, rastered, lights)
    }

    fn triangles(page: &Self::Page) -> u32 {
        Host::triangles(page)
    }

    fn most(&self) -> usize {
        Host::default().most()
    }

    fn paint(
        &mut self,
        pages: &[PageKey],
        casters: &Casters<'_>,
        held: &ShadowCache<Self::Page>,
        most: usize,
    ) -> Result<Painted<Self::Page>> {
        Host::default().paint(pages, casters, held, most)
    }
}

/// How shaders look up the maps of a frame's lights.
pub(super) fn table(lights: &FrameLights<Arc<DevicePage>>) -> Vec<[u32; 4]> {
    let entries = |own: &FrameLight<Arc<DevicePage>>| {
        let slots = own.pages.iter().filter_map(|(at, page)| Some((*at, page.slot()?)));
        shadow_map_entries(&own.view, slots)
    };
    shadow_table(&lights.iter().map(|own| own.as_ref().map(entries)).collect::<Vec<_>>())
}

fn view_of(view: &View, tau: f32) -> gpu_types::View {
    view_record(&Screen::new(view), &Eye::new(view), tau)
}

/// What pixels of a frame look up, in pages on a device.
#[derive(Debug)]
pub(super) struct DeviceShadows {
    lights: FrameLights<Arc<DevicePage>>,
    /// The same in this memory, once somebody asked for it.
    host: OnceLock<Shadows>,
}

impl DeviceShadows {
    pub(super) fn new(lights: FrameLights<Arc<DevicePage>>) -> Self {
        Self { lights, host: OnceLock::new() }
    }

    /// Whether nobody has read them yet, and there are any.
    pub(super) fn is_on_device(&self) -> bool {
        let any = self.lights.iter().flatten().any(|light| !light.pages.is_empty());
        any && self.host.get().is_none()
    }

    /// All pages, read from the device.
    pub(super) fn host(&self) -> Result<&Shadows> {
        if let Some(host) = self.host.get() {
            return Ok(host);
        }
        let light = |own: &FrameLight<Arc<DevicePage>>| -> Result<FrameLight<Arc<ShadowPage>>> {
            let pages: Vec<Arc<DevicePage>> = own.pages.iter().map(|(_, page)| Arc::clone(page)).collect();
            let read = DevicePage::read(&pages)?.into_iter().zip(&pages);
            let read = read.map(|(keys, page)| Arc::new(ShadowPage::new(keys.to_vec(), page.triangles())));
            let pages = own.pages.iter().map(|(at, _)| *at).zip(read).collect();
            Ok(FrameLight { view: own.view.clone(), pages, drawn: own.drawn.clone() })
        };
        let lights = self.lights.iter().map(|own| own.as_ref().map(light).transpose());
        let lights = lights.collect::<Result<FrameLights<Arc<ShadowPage>>>>()?;
        Ok(self.host.get_or_init(|| on_host(lights)))
    }
}
