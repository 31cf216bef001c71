//! What readers of a [`Dag`] rely on: every address, count and index in range, every float finite, the
//! hierarchy without cycles. Checksums find damage; this finds files that were made wrong on purpose.
//! (That bounds bound and errors increase is `build::check`'s business: wrong ones give wrong pictures only.)

use std::ops::Range;

use rayon::prelude::*;

use super::file::Kind;
use super::quantize::MAX_EXPONENT;
use crate::limits::{
    CLUSTER_MAX_TRIANGLES, CLUSTER_MAX_VERTICES, GROUP_MAX_CLUSTERS, MAX_LEVELS, NODE_MAX_DEPTH,
    PAGE_MAX_CLUSTERS,
};
use crate::math::octahedral::NORMAL_BITS;
use crate::model::cluster::{NO_GROUP, NO_PAGE, RECORD_WORDS};
use crate::model::packing::{PACKING_WORDS, WIDEST};
use crate::model::{
    AttributeLayout, Channel, ChannelType, ClusterGeometry, ClusterRecord, ColorFormat, Dag, Grid, Group,
    Packing, PageEntry,
};

type Fault = (Kind, String);

fn ensure(holds: bool, section: Kind, message: impl FnOnce() -> String) -> Result<(), Fault> {
    if holds { Ok(()) } else { Err((section, message())) }
}

/// Checks everything, of a mesh that is all in memory; the fault names its section.
pub fn structure(dag: &Dag) -> Result<(), Fault> {
    all_but_pages(dag)?;
    (0..dag.pages.table.len()).into_par_iter().try_for_each(|p| page(dag, p, dag.pages.page(p)))
}

/// Checks all but the words of pages; those of channels are in memory.
pub fn all_but_pages(dag: &Dag) -> Result<(), Fault> {
    head(dag)?;
    dag.channels.iter().try_for_each(|Channel { info, words }| {
        let fault = |what| (Kind::Channels, format!("channel {:?}: {what}", info.name));
        values(info.dtype, words.held()).map_err(fault)
    })
}

/// Checks the words of a page.
pub fn page(dag: &Dag, page: usize, words: &[u32]) -> Result<(), Fault> {
    let entry = &dag.pages.table[page];
    ensure(words.len() == entry.words as usize, Kind::PageTable, || {
        format!("page {page} has {} words", words.len())
    })?;
    let step = dag.grid.map_or(0.0, Grid::step);
    let limits =
        PageLimits { layout: dag.layout(), groups: &dag.groups, vertex_count: dag.vertex_count, step };
    let checked = limits.check(entry.clusters, entry.faces, words);
    let records = checked.map_err(|what| (Kind::Pages, format!("page {page}: {what}")))?;
    let stated = triangles(&dag.groups[dag.groups_of(page)], records);
    stated.map_err(|what| (Kind::Pages, format!("page {page}: {what}")))
}

/// Checks that groups, whose members are the clusters of a page, have the triangles that they say.
pub fn triangles(groups: &[Group], records: &[ClusterRecord]) -> Result<(), &'static str> {
    let mut rest = records;
    for group in groups {
        let (members, behind) =
            rest.split_at_checked(group.count as usize).ok_or("fewer clusters than its groups have")?;
        rest = behind;
        let triangles: u32 = members.iter().map(|record| u32::from(record.triangle_count)).sum();
        if ![0, triangles].contains(&u32::from(group.triangles)) {
            return Err("a group does not have the triangles that it says");
        }
    }
    Ok(())
}

/// Checks the words of a channel.
pub fn values(dtype: ChannelType, words: &[u32]) -> Result<(), &'static str> {
    if words.iter().all(|word| dtype.holds(*word)) { Ok(()) } else { Err("values that its type has not") }
}

/// Checks all but the words of pages and channels.
pub fn head(dag: &Dag) -> Result<(), Fault> {
    metadata(dag)?;
    page_table(dag)?;
    groups(dag)?;
    nodes(dag)?;
    channels(dag)?;
    let source: u64 = dag.pages.table.iter().map(|entry| u64::from(entry.faces)).sum();
    ensure(source == dag.source_faces, Kind::PageTable, || {
        format!("{source} triangles of the source, but {} in the metadata", dag.source_faces)
    })?;
    let rows = dag.face_ids.as_ref().map_or(source, |r| r.count() as u64);
    ensure(rows == source, Kind::FaceIds, || format!("{rows} rows for {source} triangles"))
}

/// Checks a grid.
pub fn grid(grid: Grid) -> Result<(), &'static str> {
    let sound = (0..=MAX_EXPONENT).contains(&grid.exponent)
        && (2..=NORMAL_BITS).contains(&grid.normal_bits)
        && grid.uv_exponent.is_none_or(|exponent| (0..=MAX_EXPONENT).contains(&exponent))
        && grid.moved.is_finite()
        && grid.moved >= 0.0;
    if sound { Ok(()) } else { Err("the grid is out of range") }
}

/// The number of clusters of a page, where the members of its groups follow each other from the first on.
pub fn members(groups: &[Group], page: usize, own: &Range<usize>) -> Option<u32> {
    groups.get(own.clone())?.iter().try_fold(0u32, |next, group| {
        let follows = group.first.page() == page && group.first.slot() == next as usize;
        let fits = group.count <= GROUP_MAX_CLUSTERS as u32;
        (follows && fits).then(|| next + group.count)
    })
}

fn finite(values: &[f32]) -> bool {
    values.iter().all(|x| x.is_finite())
}

fn metadata(dag: &Dag) -> Result<(), Fault> {
    let frame = &dag.frame;
    let sound = frame.origin.iter().all(|x| x.is_finite())
        && frame.scale.is_finite()
        && frame.scale > 0.0
        && frame.rounding.is_finite()
        && frame.rounding >= 0.0
        && finite(&dag.bounds.min)
        && finite(&dag.bounds.max);
    ensure(sound, Kind::Metadata, || "frame or bounds are not finite".into())?;
    dag.grid.map_or(Ok(()), grid).map_err(|what| (Kind::Metadata, what.into()))?;
    // Identities are used as indices: a file cannot make a reader allocate more than it holds itself.
    let words = dag.pages.word_count();
    ensure(u64::from(dag.vertex_count) <= words, Kind::Metadata, || {
        format!("{} vertices in pages of {words} words", dag.vertex_count)
    })
}

fn page_table(dag: &Dag) -> Result<(), Fault> {
    let mut last = PageEntry::default();
    for (p, entry) in dag.pages.table.iter().enumerate() {
        let follows = *entry == last.next(entry.words, entry.clusters, entry.level, entry.faces);
        ensure(follows, Kind::PageTable, || format!("page {p} does not follow the one before"))?;
        let fits = (1..=PAGE_MAX_CLUSTERS as u32).contains(&entry.clusters)
            && entry.clusters as usize * RECORD_WORDS <= entry.words as usize;
        ensure(fits, Kind::PageTable, || format!("page {p} does not fit"))?;
        last = *entry;
    }
    Ok(())
}

/// What the numbers in a page must stay below.
#[derive(Clone, Copy, Debug)]
pub struct PageLimits<'a> {
    /// Streams of every cluster.
    pub layout: AttributeLayout,
    /// All groups.
    pub groups: &'a [Group],
    /// Number of vertex identities.
    pub vertex_count: u32,
    /// Internal units per step of the grid that positions lie on; 0 where there is none.
    pub step: f32,
}

impl PageLimits<'_> {
    /// Checks the words of a page of so many clusters and triangles of the source; returns its records.
    pub fn check<'w>(
        &self,
        clusters: u32,
        faces: u32,
        words: &'w [u32],
    ) -> Result<&'w [ClusterRecord], String> {
        let head = words.get(..clusters as usize * RECORD_WORDS).ok_or("clusters do not fill the page")?;
        let records: &[ClusterRecord] = bytemuck::cast_slice(head);
        for (slot, record) in records.iter().enumerate() {
            self.cluster(record, words).map_err(|what| format!("cluster {slot}: {what}"))?;
        }
        let source = records.iter().filter(|record| record.level == 0);
        let sum: u32 = source.map(|record| u32::from(record.triangle_count)).sum();
        if sum == faces {
            Ok(records)
        } else {
            Err(format!("{sum} triangles of the source instead of {faces}"))
        }
    }

    fn cluster(&self, record: &ClusterRecord, words: &[u32]) -> Result<(), &'static str> {
        let fault = |holds: bool, what: &'static str| if holds { Ok(()) } else { Err(what) };
        let (vertices, triangles) = (usize::from(record.vertex_count), usize::from(record.triangle_count));
        fault((1..=CLUSTER_MAX_TRIANGLES).contains(&triangles), "number of triangles")?;
        fault((1..=CLUSTER_MAX_VERTICES).contains(&vertices), "number of vertices")?;
        let rest = words.get(record.data as usize..).unwrap_or_default();
        let head = rest.get(..PACKING_WORDS).ok_or("streams")?;
        let Packing { widths, step, .. } = bytemuck::pod_read_unaligned(bytemuck::cast_slice(head));
        fault(widths.iter().zip(WIDEST).all(|(bits, most)| *bits <= most), "widths")?;
        let own = rest.get(..self.layout.streams(vertices, triangles, widths).end).ok_or("streams")?;
        let group = self.groups.get(record.group as usize).ok_or("group")?;
        fault(record.error >= group.min_own_error, "error")?;
        let origin = self.groups.get(record.refined as usize);
        fault(record.refined == NO_GROUP || origin.is_some(), "origin")?;
        let page = origin.map_or(NO_PAGE, |group| group.first.page() as u32);
        fault(record.refined_page == page, "page of its origin")?;
        fault(
            finite(&record.center) && finite(&record.extent) && finite(&record.lod_sphere.center),
            "bounds",
        )?;
        let sizes = [record.radius, record.lod_sphere.radius, record.error, record.max_edge];
        fault(finite(&sizes) && record.lod_sphere.radius >= 0.0, "sizes")?;
        let geometry = ClusterGeometry::new(own, self.layout, vertices, triangles);
        fault(geometry.triangles.iter().flatten().all(|v| usize::from(v) < vertices), "corners")?;
        fault(geometry.ids.iter().all(|id| id < self.vertex_count), "identities")?;
        let positions = step > 0.0 || geometry.positions.iter().all(|p| finite(&p));
        fault(step == self.step && positions, "positions")?;
        let colors: &[f32] = match self.layout.colors {
            ColorFormat::Float32 => bytemuck::cast_slice(geometry.colors),
            _ => &[],
        };
        fault(colors.iter().all(|x| (0.0..=1.0).contains(x)), "colours")?;
        fault(finite(geometry.uvs.as_flattened()), "UVs")
    }
}

fn channels(dag: &Dag) -> Result<(), Fault> {
    for (i, Channel { info, words }) in dag.channels.iter().enumerate() {
        let fault = |holds: bool, what: &str| {
            ensure(holds, Kind::Channels, || format!("channel {:?}: {what}", info.name))
        };
        let known = dag.channels[..i].iter().any(|c| c.info.name == info.name);
        fault(!info.name.is_empty() && !known, "name")?;
        fault(info.width() > 0, "width")?;
        fault(words.count() == info.width() * dag.vertex_count as usize, "number of rows")?;
    }
    Ok(())
}

fn groups(dag: &Dag) -> Result<(), Fault> {
    let mut clusters_before = 0;
    for (g, group) in dag.groups.iter().enumerate() {
        let fault = |holds: bool, what: &str| ensure(holds, Kind::Groups, || format!("group {g}: {what}"));
        let (page, slot) = (group.first.page(), group.first.slot());
        let clusters = dag.pages.table.get(page).map_or(0, |e| e.clusters as usize);
        fault((1..=GROUP_MAX_CLUSTERS).contains(&(group.count as usize)), "number of members")?;
        fault(slot + group.count as usize <= clusters, "members")?;
        fault(dag.pages.dense_index(group.first) == clusters_before, "members do not follow those before")?;
        clusters_before += group.count as usize;
        fault(finite(&group.center) && finite(&group.extent), "box")?;
        fault(finite(&group.lod_sphere.center) && group.lod_sphere.radius.is_finite(), "sphere")?;
        fault(group.error > 0.0 && group.error >= group.attribute_error, "error")?;
        fault(group.bound >= 0.0 && group.quadric >= 0.0, "bound")?;
        fault(group.rank >= 0.0, "rank")?;
        fault(group.min_own_error.is_finite(), "least error")?;
        fault(group.level < MAX_LEVELS, "level")?;
    }
    let clusters = dag.cluster_count();
    ensure(clusters_before == clusters, Kind::Groups, || {
        format!("{clusters_before} members for {clusters} clusters")
    })?;
    // What is made of groups is in groups, too. Files of before do not say how many triangles they have.
    let stated = dag.groups.iter().all(|group| group.triangles > 0);
    let source: i64 = dag.groups.iter().map(|g| i64::from(g.triangles) - i64::from(g.made)).sum();
    ensure(!stated || source == dag.source_faces as i64, Kind::Groups, || {
        format!("they have {source} triangles of the source, but {} in the metadata", dag.source_faces)
    })
}

fn nodes(dag: &Dag) -> Result<(), Fault> {
    ensure(!dag.nodes.is_empty(), Kind::Nodes, || "there is no root".into())?;
    // Children come after their parents and belong to one parent: walks end, and visit nothing twice.
    let mut next_node = 1u64;
    let mut groups_seen = vec![false; dag.groups.len()];
    let mut depths = vec![1u16; dag.nodes.len()];
    for (n, node) in dag.nodes.iter().enumerate() {
        let fault = |holds: bool, what: &str| ensure(holds, Kind::Nodes, || format!("node {n}: {what}"));
        let (first, count) = (u64::from(node.first), u64::from(node.count));
        if node.is_leaf == 1 {
            fault(first + count <= dag.groups.len() as u64, "groups")?;
            for g in first..first + count {
                let least = dag.groups[g as usize].min_own_error;
                fault(node.min_own_error <= least, "least error")?;
                fault(!std::mem::replace(&mut groups_seen[g as usize], true), "a group is in two leaves")?;
            }
        } else {
            fault(node.is_leaf == 0, "kind")?;
            fault(first == next_node && first > n as u64, "children do not follow in order")?;
            fault(first + count <= dag.nodes.len() as u64, "children")?;
            let children = &dag.nodes[first as usize..][..count as usize];
            let least = children.iter().all(|child| node.min_own_error <= child.min_own_error);
            fault(least, "least error")?;
            next_node += count;
            fault(depths[n] < NODE_MAX_DEPTH, "it is too far below the root")?;
            let below = depths[n] + 1;
            depths[first as usize..][..count as usize].fill(below);
        }
        fault(finite(&node.center) && finite(&node.extent), "box")?;
        fault(finite(&node.lod_sphere.center) && node.lod_sphere.radius.is_finite(), "sphere")?;
        fault(!node.max_parent_error.is_nan(), "error")?;
    }
    Ok(())
}
