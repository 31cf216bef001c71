//! From groups on disk to pages: what [`crate::build::assemble`] does, with tables of groups in memory and one window of their
//! clusters.

use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;

use super::block::{Common, GroupEntry, Made};
use super::page_file::PageFileSink;
use super::spool::{Record, SpoolReader};
use crate::build::assemble::{Member, Packed, write_page};
use crate::build::bits::Bits;
use crate::build::dag::{BuildCluster, group_number};
use crate::error::{Error, Result};
use crate::layout::{GroupSize, Paging, hierarchy, paginate, spatial_order};
use crate::limits::CLUSTER_MAX_TRIANGLES;
use crate::math::Aabb;
use crate::model::cluster::{NO_GROUP, NO_PAGE};
use crate::model::rule::ROOT_ERROR;
use crate::model::{
    BuildReport, Channel, ChannelInfo, Dag, GeometryId, Group, Materials, Outline, PageWords, Pages,
    Primitive, dependencies,
};

/// Groups that are looked at at a time.
const WINDOW: usize = 1 << 10;
/// An identity without a name.
const UNNAMED: u32 = u32::MAX;

/// All that the blocks of all stages made.
pub struct Stages<'a> {
    /// The blocks, stage by stage.
    pub made: &'a [Made],
    /// What reads the records of each block.
    pub readers: &'a [SpoolReader],
    /// The number of the first block of each stage.
    pub starts: &'a [usize],
    /// The number of the first group of each block.
    pub first_group: &'a [u32],
    /// What all have in common.
    pub common: &'a Common<'a>,
}

/// A group by its block and its number there.
#[derive(Clone, Copy)]
struct At {
    block: u32,
    group: u32,
}

impl Stages<'_> {
    fn entry(&self, at: At) -> &GroupEntry {
        &self.made[at.block as usize].groups[at.group as usize]
    }

    /// The number over all blocks of the group that a cluster of one names; [`NO_GROUP`] where it names none.
    fn refined(&self, block: u32, refined: u32) -> u32 {
        group_number(refined, self.first_group[block as usize])
    }

    /// Reads groups and makes something of each, in parallel and in order.
    fn each<T: Send>(&self, groups: &[At], of: impl Fn(At, Record) -> Result<T> + Sync) -> Result<Vec<T>> {
        groups
            .par_iter()
            .map(|at| of(*at, self.readers[at.block as usize].read(self.entry(*at).place)?))
            .collect()
    }

    /// Identities of all blocks by name, in the order of their first use; and how many there are.
    fn names(&self, order: &[At]) -> Result<(Vec<Vec<u32>>, u32)> {
        let mut names: Vec<Vec<u32>> =
            self.made.iter().map(|made| vec![UNNAMED; made.summary.identities as usize]).collect();
        let mut count = 0;
        // The last stage comes first: it says what the one before calls what both have.
        let mut stage = self.starts.len();
        for groups in order.chunks(WINDOW) {
            let used = self.each(groups, |_, record| Ok(record.ids))?;
            for (at, ids) in groups.iter().zip(used) {
                while stage > 0 && (at.block as usize) < self.starts[stage - 1] {
                    stage -= 1;
                    self.hand_down(stage, &mut names);
                }
                for id in ids {
                    let name = &mut names[at.block as usize][id as usize];
                    if *name == UNNAMED {
                        *name = count;
                        count += 1;
                    }
                }
            }
        }
        Ok((names, count))
    }

    fn hand_down(&self, stage: usize, names: &mut [Vec<u32>]) {
        let end = self.starts.get(stage + 1).copied().unwrap_or(self.made.len());
        for block in self.starts[stage]..end {
            for [own, origin, id] in &self.made[block].origins {
                names[*origin as usize][*id as usize] = names[block][*own as usize];
            }
        }
    }
}

/// Lays all groups out; pages go to a file in `folder`.
pub fn assemble(
    stages: &Stages<'_>,
    bounds: Aabb,
    source_faces: u64,
    mut report: BuildReport,
    folder: &Path,
) -> Result<Dag> {
    let common = stages.common;
    let blocks = (0..).zip(stages.made);
    let all: Vec<At> = blocks
        .flat_map(|(block, made)| (0..made.groups.len() as u32).map(move |group| At { block, group }))
        .collect();
    let keys = all.iter().map(|at| (stages.entry(*at).level, stages.entry(*at).bounds));
    let spatial = spatial_order(keys);
    let in_order: Vec<At> = spatial.iter().map(|g| all[*g as usize]).collect();
    let (names, vertex_count) = stages.names(&in_order)?;
    let names_of = |at: At, record: &Record| -> Vec<u32> {
        record.ids.iter().map(|id| names[at.block as usize][*id as usize]).collect()
    };
    // Of each group its words, its triangles, and what its clusters were made from.
    let mut seen: Vec<(u32, u16, Vec<u32>)> = Vec::with_capacity(all.len());
    // Triangles of what was made from each.
    let mut made = vec![0u16; all.len()];
    let mut source_used = Bits::new(vertex_count as usize);
    let widths: Vec<usize> = common.channels.iter().map(ChannelInfo::width).collect();
    let width = widths.iter().sum::<usize>();
    let mut columns: Vec<Vec<u32>> = widths.iter().map(|of| vec![0; vertex_count as usize * of]).collect();
    for groups in all.chunks(WINDOW) {
        let found = stages.each(groups, |at, record| {
            let names = names_of(at, &record);
            let words = record.clusters.iter().map(|c| Packed::of(&record.store, c, &names).words());
            let words = words.sum::<usize>() as u32;
            let refined = |c: &BuildCluster| stages.refined(at.block, c.refined);
            let clusters: Vec<(u32, u16)> =
                record.clusters.iter().map(|c| (refined(c), c.mesh.triangles.len() as u16)).collect();
            let of_source = record.clusters.iter().filter(|c| c.level == 0);
            let used: Vec<u32> =
                of_source.flat_map(|c| &c.mesh.vertices).map(|v| names[*v as usize]).collect();
            Ok((words, clusters, used, names, record.words))
        })?;
        for (size, clusters, used, names, words) in found {
            for (name, row) in names.iter().zip(words.chunks_exact(width.max(1))) {
                let mut rest = row;
                for (column, width) in columns.iter_mut().zip(&widths) {
                    let (own, behind) = rest.split_at(*width);
                    column[*name as usize * width..][..*width].copy_from_slice(own);
                    rest = behind;
                }
            }
            for (refined, triangles) in &clusters {
                if let Some(made) = made.get_mut(*refined as usize) {
                    *made += triangles;
                }
            }
            let triangles = clusters.iter().map(|(_, triangles)| triangles).sum();
            seen.push((size, triangles, clusters.into_iter().map(|(refined, _)| refined).collect()));
            for name in used {
                source_used.set(name);
            }
        }
    }
    let source_vertices = source_used.count();
    drop(source_used);
    let Paging { table, order, first } = paginate(&spatial, |g| {
        let entry = stages.entry(all[g as usize]);
        GroupSize {
            level: entry.level,
            root: entry.error == ROOT_ERROR,
            clusters: entry.clusters,
            words: seen[g as usize].0,
            faces: entry.faces,
        }
    });
    let boxes: Vec<Aabb> = order.iter().map(|g| stages.entry(all[*g as usize]).bounds).collect();
    let groups: Vec<Group> = order
        .iter()
        .zip(&first)
        .zip(&boxes)
        .map(|((g, first), bounds)| {
            let group = stages.entry(all[*g as usize]);
            let (center, extent) = bounds.center_extent();
            Group {
                lod_sphere: group.lod_sphere,
                error: group.error,
                first: *first,
                count: group.clusters,
                level: group.level,
                center,
                extent,
                bound: group.bound,
                quadric: group.quadric,
                attribute_error: group.attribute_error,
                min_own_error: group.min_own_error,
                rank: group.rank,
                triangles: seen[*g as usize].1,
                made: made[*g as usize],
            }
        })
        .collect();
    let mut renamed = vec![0; order.len()];
    order.iter().zip(0..).for_each(|(old, new)| renamed[*old as usize] = new);
    let made_from = |refined: u32| match renamed.get(refined as usize) {
        Some(group) => (*group, groups[*group as usize].first.page() as u32),
        None => (NO_GROUP, NO_PAGE),
    };
    report.clusters = table.iter().map(|entry| u64::from(entry.clusters)).sum();
    report.triangles = seen.iter().map(|group| u64::from(group.1)).sum();
    report.fill = report.triangles as f64 / (report.clusters as usize * CLUSTER_MAX_TRIANGLES) as f64;
    report.welded_vertices = report.input_vertices - report.unreferenced_vertices - source_vertices;
    let mut face_ids = Vec::new();
    if common.options.face_ids {
        for window in order.chunks(WINDOW) {
            let places: Vec<At> = window.iter().map(|g| all[*g as usize]).collect();
            let rows = stages.each(&places, |_, record| Ok(record.face_rows.concat()))?;
            face_ids.extend(rows.into_iter().flatten());
        }
    }
    let infos = common.channels.iter().cloned().zip(columns);
    let channels = infos.map(|(info, words)| Channel { info, words: words.into() }).collect();
    let mesh = Dag {
        id: GeometryId::default(),
        topology: None,
        frame: common.frame,
        bounds,
        pages: Arc::new(Pages::absent(table.into(), common.layout)),
        nodes: hierarchy(&groups, &boxes),
        groups: groups.as_slice().into(),
        vertex_count,
        channels,
        source_faces,
        source_vertices,
        face_ids: common.options.face_ids.then(|| face_ids.into()),
        materials: Materials::default(),
        primitive: Primitive::Triangles,
        grid: None,
        pose: None,
        report,
    };
    let refined = |page: usize| {
        let own = order[mesh.groups_of(page)].iter().flat_map(|g| &seen[*g as usize].2);
        own.map(|refined| made_from(*refined).1)
    };
    let dependencies = dependencies(mesh.pages.table.len(), refined);
    let sink = PageFileSink::create(&folder.join("pages"))?;
    Outline { mesh, dependencies }.fill(sink, |mesh, pages| {
        let page = |page: usize| -> Result<PageWords> {
            let own = mesh.groups_of(page);
            let places: Vec<At> = order[own.clone()].iter().map(|g| all[*g as usize]).collect();
            let records = stages.each(&places, |at, record| {
                let names = names_of(at, &record);
                let packed: Vec<Packed> =
                    record.clusters.iter().map(|c| Packed::of(&record.store, c, &names)).collect();
                Ok((record, names, packed))
            })?;
            let numbered = own.zip(&places).zip(&records);
            let members: Vec<Member<'_>> = numbered
                .flat_map(|((group, at), (record, names, packed))| {
                    record.clusters.iter().zip(packed).map(move |(cluster, packed)| {
                        let made_from = made_from(stages.refined(at.block, cluster.refined));
                        Member {
                            cluster,
                            store: &record.store,
                            names,
                            packed,
                            group: group as u32,
                            made_from,
                        }
                    })
                })
                .collect();
            Ok(write_page(members.into_iter()))
        };
        pages.into_par_iter().map(page).collect::<Result<Vec<_>>>()
    })
}

/// More groups, or identities, than 32 bits count.
pub fn too_many(what: &str) -> Error {
    Error::TooLarge(format!("more than 2^31 {what} over all levels"))
}
