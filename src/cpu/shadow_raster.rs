//! Pages of shadow maps that are wanted → their depths: instances, nodes and clusters are culled for all pages of a block
//! together, then each page is drawn by one task.

use std::sync::Arc;

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::cluster_cull::{self, CandidateCluster};
use super::node_cull::{self, CandidateGroup};
use super::shadow_mask::{Mask, Walls, farthest};
use super::visibility::{Nearest, Pixel};
use super::{instance_cull, raster_large, raster_small};
use crate::limits::{
    SHADOW_FEW_CLUSTERS, SHADOW_PAGE_SIDE, SHADOW_PAGE_TEXELS, SHADOW_ROUNDING, SHADOW_SIDE, SHADOW_TILE_SIDE,
};
use crate::scene::placement::Eye;
use crate::scene::{Instance, Scene};
use crate::shadow::page::TILES_ACROSS;
use crate::shadow::{Block, Grid, PageKey, ShadowCache, ShadowMap, ShadowPage};
use crate::stream::Resident;
use crate::views::{Footprint, InstanceView, Occluder, Screen, Visible};

/// What was drawn of a block.
#[derive(Debug, Default)]
pub struct DrawnBlock {
    /// Its pages, and whether nothing stands in them for what is not there.
    pub pages: Vec<(PageKey, Arc<ShadowPage>, bool)>,
    /// Instances as seen by it.
    pub views: Vec<InstanceView>,
    /// Groups that were to be drawn and whose pages are not there.
    pub absent: Vec<CandidateGroup>,
    /// Clusters drawn, each once for every page that it may touch.
    pub clusters: u64,
    /// Instances that cast nothing that is looked up, or that others hide from the light.
    pub culled_instances: u64,
    /// Clusters of others of which the same is true; in virtual pages each once for every page.
    pub culled_clusters: u64,
}

/// What is drawn for one frame alone.
#[derive(Clone, Copy)]
pub struct Cascaded<'a> {
    /// How deep what is looked up lies, by which casters are left out; `None` to draw all.
    pub walls: Option<&'a Walls>,
    /// What lights were seen to see, and still do.
    pub seen: Option<&'a ShadowCache<Arc<ShadowPage>>>,
}

impl Cascaded<'_> {
    fn mask(&self, block: &Block, pages: &[PageKey]) -> Option<Mask> {
        let seen = |page: &PageKey| Some(&**self.seen?.page(page)?);
        Some(Mask::new(block, pages, self.walls?, seen))
    }
}

/// The pages of a block that are drawn: everything else is culled.
struct Wanted(Grid);

impl Wanted {
    /// Columns and rows of pages that a footprint touches, the last ones included.
    fn rect(footprint: &Footprint) -> [usize; 4] {
        footprint.rect.map(|v| usize::from(v) / SHADOW_PAGE_SIDE as usize)
    }
}

impl Occluder for Wanted {
    fn hides(&self, footprint: &Footprint) -> bool {
        !self.0.any(Self::rect(footprint))
    }
}

/// What touches a wanted page and is of use there.
struct Useful<'a>(&'a Wanted, Option<&'a Mask>);

impl Occluder for Useful<'_> {
    fn hides(&self, footprint: &Footprint) -> bool {
        self.0.hides(footprint) || self.1.is_some_and(|mask| mask.hides(footprint))
    }
}

/// Draws pages, sorted by block; those of directional lights for one frame alone, if it is said what for. With `occlusion` what
/// other casters hide from the light is left out, which changes no page.
pub fn run(
    pages: &[PageKey],
    maps: &FxHashMap<u32, ShadowMap>,
    scene: &Scene,
    resident: &Resident,
    cascaded: Option<Cascaded<'_>>,
    occlusion: bool,
) -> Vec<DrawnBlock> {
    let casters: Vec<(u32, &Instance)> = scene
        .instances()
        .iter()
        .filter(|(_, instance)| instance.visible && instance.casts_shadows())
        .collect();
    pages
        .chunk_by(|a, b| a.block() == b.block())
        .map(|pages| {
            let map = &maps[&pages[0].light];
            let cascaded = cascaded.filter(|_| map.parallel());
            draw_block(pages, map, scene, &casters, resident, cascaded, occlusion)
        })
        .collect()
}

fn draw_block(
    pages: &[PageKey],
    map: &ShadowMap,
    scene: &Scene,
    casters: &[(u32, &Instance)],
    resident: &Resident,
    cascaded: Option<Cascaded<'_>>,
    occlusion: bool,
) -> DrawnBlock {
    let block = pages[0].block();
    let mask = cascaded.and_then(|cascaded| cascaded.mask(&block, pages));
    let wanted = Wanted(Grid::new(&block, pages, 0));
    let useful = Useful(&wanted, mask.as_ref());
    let view = map.block_view(&block);
    let (eye, screen) = (Eye::new(&view), Screen::new(&view));
    let tau = PageKey::threshold(block.0.tau);
    let mut views = instance_cull::run(casters, &view, &eye, &screen, resident);
    views.retain(|view| !wanted.hides(&view.footprint));
    let touching = views.len();
    views.retain(|view| !useful.hides(&view.footprint));
    let culled_instances = (touching - views.len()) as u64;
    // What faces away from a light stops it as well.
    views.iter_mut().for_each(|view| view.two_sided = true);
    let numbers: Vec<u32> = (0..views.len() as u32).collect();
    let walk = node_cull::run(&numbers, &views, &screen, tau, Some(&useful));
    let mut clusters = cluster_cull::run(&walk.groups, &views, &screen, tau, Some(&wanted)).candidates;
    // What is seen through stops no light.
    if views.iter().any(|view| view.materials.any_blended(true)) {
        clusters.retain(|cluster| !cluster.is_blended(&views));
    }
    let touching = clusters.len();
    if let Some(mask) = &mask {
        clusters = cluster_cull::unhidden(&clusters, mask);
    }
    let of_pages = of_pages(&wanted.0, pages.len(), &clusters);
    let lacking = lacking(&walk.absent, &views, &screen);
    let draw = |key: PageKey, numbers: &[u32]| {
        let as_culled = cascaded.is_some();
        PageDrawing { map, key, clusters: &clusters, views: &views, scene, as_culled, occlusion }
            .draw(numbers)
    };
    let drawn: Vec<DrawnPage> =
        pages.par_iter().zip(&of_pages).map(|(key, numbers)| draw(*key, numbers)).collect();
    let listed: usize = of_pages.iter().map(Vec::len).sum();
    let drawn_clusters: u64 = drawn.iter().map(|page| page.clusters).sum();
    let whole = |key: &PageKey| {
        let [x, y] = block.place(key);
        !lacking.iter().any(|[x0, y0, x1, y1]| (x0..=x1).contains(&&x) && (y0..=y1).contains(&&y))
    };
    DrawnBlock {
        absent: walk.absent,
        clusters: drawn_clusters,
        culled_instances,
        culled_clusters: (touching - clusters.len()) as u64 + listed as u64 - drawn_clusters,
        pages: pages.iter().zip(drawn).map(|(key, drawn)| (*key, drawn.page, whole(key))).collect(),
        views,
    }
}

/// Columns and rows of the pages that groups would touch whose pages are not there.
fn lacking(absent: &[CandidateGroup], views: &[InstanceView], screen: &Screen) -> Vec<[usize; 4]> {
    let rect = |at: &CandidateGroup| {
        let view = &views[at.instance as usize];
        let group = &view.mesh.groups[at.group as usize];
        Some(Wanted::rect(&view.footprint(screen, group.center, group.extent)?))
    };
    absent.iter().filter_map(rect).collect()
}

/// The clusters that may touch each page.
fn of_pages(grid: &Grid, pages: usize, clusters: &[CandidateCluster]) -> Vec<Vec<u32>> {
    let mut lists = vec![Vec::new(); pages];
    for (number, cluster) in (0..).zip(clusters) {
        for page in grid.numbers(Wanted::rect(&cluster.footprint)) {
            lists[page as usize].push(number);
        }
    }
    lists
}

/// What was drawn of a page.
struct DrawnPage {
    page: Arc<ShadowPage>,
    clusters: u64,
}

/// A page that is drawn.
struct PageDrawing<'a> {
    map: &'a ShadowMap,
    key: PageKey,
    clusters: &'a [CandidateCluster],
    views: &'a [InstanceView],
    scene: &'a Scene,
    /// Vertices lie where culling took them to be, but for less than 1/1000 texel: what is left out then has no texel in front.
    as_culled: bool,
    /// What is hidden is left out.
    occlusion: bool,
}

impl PageDrawing<'_> {
    /// The depths of the page: bits that depend on its key and on what there is, and not on what else is drawn. The nearer half
    /// of the clusters is drawn first, then what that does not hide.
    fn draw(&self, numbers: &[u32]) -> DrawnPage {
        let mut texels = vec![0u32; SHADOW_PAGE_TEXELS];
        let (near, mut far) = self.halves(numbers);
        self.pass(&near, &mut texels);
        if !far.is_empty() {
            self.leave_out_hidden(&mut far, &texels);
            self.pass(&far, &mut texels);
        }
        let drawn = || near.iter().chain(&far).map(|number| &self.clusters[*number as usize]);
        let triangles = drawn().map(|cluster| u32::from(cluster.triangles)).sum();
        let clusters = drawn().count() as u64;
        DrawnPage { clusters, page: Arc::new(ShadowPage::new(texels, triangles)) }
    }

    /// The clusters that are nearer to the light than half of them, and the others, in their order.
    fn halves(&self, numbers: &[u32]) -> (Vec<u32>, Vec<u32>) {
        if numbers.len() <= SHADOW_FEW_CLUSTERS as usize || !self.occlusion {
            return (numbers.to_vec(), Vec::new());
        }
        let near_key = |number: &u32| self.clusters[*number as usize].footprint.near_key;
        let mut keys: Vec<u32> = numbers.iter().map(near_key).collect();
        let middle = keys.len() / 2;
        let (_, pivot, _) = keys.select_nth_unstable(middle);
        let pivot = *pivot;
        numbers.iter().partition(|number| near_key(number) >= pivot)
    }

    /// Leaves out clusters that lie behind all that was drawn where they are.
    fn leave_out_hidden(&self, numbers: &mut Vec<u32>, texels: &[u32]) {
        let tiles = farthest(texels);
        let side = SHADOW_PAGE_SIDE as usize;
        let [left, top] = self.key.block().place(&self.key).map(|at| at * side);
        numbers.retain(|number| {
            let Footprint { rect: [x0, y0, x1, y1], near_key, .. } =
                self.clusters[*number as usize].footprint;
            let near_key = self.nearer(near_key);
            let within = |low: u16, high: u16, from: usize| {
                let [low, high] = [low, high].map(|at| usize::from(at).clamp(from, from + side - 1) - from);
                low / SHADOW_TILE_SIDE as usize..=high / SHADOW_TILE_SIDE as usize
            };
            let columns = within(x0, x1, left);
            !within(y0, y1, top)
                .all(|y| tiles[y * TILES_ACROSS..][columns.clone()].iter().all(|key| near_key < *key))
        });
    }

    /// A key that no vertex of something with this one exceeds in the page: a parallel map's page has an eye of its own, from
    /// which depths are rounded otherwise than from that of its block.
    fn nearer(&self, near_key: u32) -> u32 {
        if !self.map.parallel() {
            return near_key;
        }
        let depth = f32::from_bits(!near_key);
        let side = SHADOW_SIDE as f32 * ShadowMap::texel(self.key.level) as f32;
        !(depth - (depth + side) * SHADOW_ROUNDING).max(0.0).to_bits()
    }

    /// Draws clusters.
    fn pass(&self, numbers: &[u32], texels: &mut [u32]) {
        let Self { map, key, clusters, views, scene, as_culled, .. } = self;
        let view = map.page_view(key);
        let (eye, screen) = (Eye::new(&view), Screen::new(&view));
        let mut own: Vec<InstanceView> = Vec::new();
        let mut last = u32::MAX;
        let (mut visible, mut small, mut large) = (Vec::with_capacity(numbers.len()), Vec::new(), Vec::new());
        for (number, cluster) in (0..).zip(numbers.iter().map(|number| &clusters[*number as usize])) {
            let Visible { instance, cluster: address } = cluster.visible;
            if instance != last {
                last = instance;
                let view = &views[instance as usize];
                // The scene does not change while it is drawn.
                let placed = scene.instances().at(view.slot as usize).map(Instance::placement);
                own.extend(placed.map(|placement| match as_culled {
                    true => {
                        view.shifted(key.block().place(key).map(|at| at as f32 * SHADOW_PAGE_SIDE as f32))
                    }
                    false => view.moved_to(&eye, screen.orthographic, placement),
                }));
            }
            visible.push(Visible { instance: own.len() as u32 - 1, cluster: address });
            if cluster.large { large.push(number) } else { small.push(number) }
        }
        let sink = Nearest(u32::cells(texels));
        raster_small::run(&small, &visible, &own, &screen, &sink);
        raster_large::run(&large, &visible, &own, &screen, &sink);
    }
}
