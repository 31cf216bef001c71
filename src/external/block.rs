//! One block: levels grow over its surface, and what others share stays. A function of files: of the source, or of what the
//! blocks of the stage before left.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};
use serde::{Deserialize, Serialize};

use super::lists;
use super::source::{AROUND, BORDER, OWN};
use super::spool::{Place, SpoolReader, SpoolWriter};
use crate::build::Meter;
use crate::build::assemble::face_ids;
use crate::build::clusterize::{ClusterMesh, clusterize};
use crate::build::content::{Content, weights};
use crate::build::dag::{BuildCluster, Grown, Part, Start, group_number, grow_from};
use crate::build::order;
use crate::build::silhouette::Silhouette;
use crate::build::store::VertexStore;
use crate::config::BuildOptions;
use crate::error::{Error, Result};
use crate::math::{Aabb, Sphere};
use crate::mesh::channels::Scale;
use crate::mesh::edges::Edges;
use crate::mesh::{Channels, Colors, Positions, SourceChannel, SourceMesh, WeldedMesh, frame, hash, weld_in};
use crate::model::{AttributeLayout, BuildReport, ChannelInfo, CoordinateFrame};

/// Of a block of the source one in so many triangles is left to the next stage: about where its reference has served
/// ([`crate::build::reference`]), so that no further distance adds up.
pub const LEFT_OF_SOURCE: u64 = 64;
/// The same of further stages.
pub const LEFT: u64 = 16;
/// A block leaves so many triangles for each position on its border: what is left is coarse, and the border is not, so that
/// triangles along it would be long and thin.
const LEFT_PER_FIXED: u64 = 8;
/// But no more than one in so many.
const MOST_LEFT: u64 = 4;

/// Of so many triangles of a block, how many are left to the next stage: one in `part`, or what its border asks for.
fn enough(triangles: u64, part: u64, fixed: &FxHashSet<[u32; 3]>) -> u64 {
    (triangles / part).max((LEFT_PER_FIXED * fixed.len() as u64).min(triangles / MOST_LEFT))
}

/// A group on disk; see [`crate::model::Group`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct GroupEntry {
    /// Encloses the LOD spheres of its clusters.
    pub lod_sphere: Sphere,
    /// The box around its clusters.
    pub bounds: Aabb,
    /// Their parent error.
    pub error: f32,
    /// Proven distance of what was made of them.
    pub bound: f32,
    /// The simplifiers' estimate of it.
    pub quadric: f32,
    /// Deviation of attributes in what was made of them.
    pub attribute_error: f32,
    /// What the group costs.
    pub rank: f32,
    /// The least own error of a cluster.
    pub min_own_error: f32,
    /// Level in which it was formed.
    pub level: u32,
    /// Number of its clusters.
    pub clusters: u32,
    /// Triangles of the source among theirs.
    pub faces: u32,
    /// Where its clusters lie.
    pub place: Place,
}

/// A cluster that is left to the next stage.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct LeftEntry {
    /// Number of its triangles.
    pub triangles: u32,
    /// The box around it.
    pub bounds: Aabb,
    /// Where it lies.
    pub place: Place,
}

/// What a block made, but for the records of its groups and of what it leaves.
#[derive(Debug, Default)]
pub struct Made {
    /// Its groups.
    pub groups: Vec<GroupEntry>,
    /// What it leaves to the next stage.
    pub left: Vec<LeftEntry>,
    /// Identities that were another block's of the stage before: its own number, the block, and the number there; one has
    /// several origins where blocks shared it.
    pub origins: Vec<[u32; 3]>,
    /// All else.
    pub summary: Summary,
}

/// What a block made, in numbers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Summary {
    /// Number of its identities.
    pub identities: u32,
    /// What the build did.
    pub report: BuildReport,
    /// The box of its triangles of the source: the smallest and the largest corner; nothing where there are none.
    pub bounds: Option<[[f32; 3]; 2]>,
    /// What was mended in the source.
    pub mended: Mended,
    /// The first level that it made, and the one after the last.
    pub levels: Range<u32>,
}

/// What all blocks have in common.
#[derive(Debug)]
pub struct Common<'a> {
    /// Internal to object space.
    pub frame: CoordinateFrame,
    /// Streams of every cluster.
    pub layout: AttributeLayout,
    /// Floats of a row of attributes.
    pub stride: usize,
    /// Named channels,
    pub channels: &'a [ChannelInfo],
    /// and how those that are floats are scaled.
    pub scales: &'a [Scale],
    /// Triangles of the source, before mending.
    pub source_faces: usize,
    /// Normals are computed.
    pub computed_normals: bool,
    /// The silhouette of the source, where area is preserved.
    pub silhouette: Option<Silhouette>,
    /// How to build.
    pub options: &'a BuildOptions,
}

/// Grows the levels of a block of the source.
pub fn of_source(
    source: &SourceMesh<'_>,
    (block, blocks): (usize, usize),
    common: &Common<'_>,
    folder: &Path,
    path: PathBuf,
    meter: &Meter<'_>,
) -> Result<Made> {
    let mut report = BuildReport::default();
    let mut own = lists::read(folder, OWN, block)?;
    own.sort_unstable();
    let mut all = lists::read(folder, AROUND, block)?;
    all.extend_from_slice(&own);
    all.sort_unstable();
    all.dedup();
    let gathered = Gathered::new(source, &all, &common.frame);
    let positions = gathered.positions.clone();
    let (frame, scales, crease) = (common.frame, Some(common.scales), common.options.crease_angle);
    let mut mesh = match weld_in(&gathered.mesh(), positions, frame, scales, crease, &mut report) {
        // Others have more.
        Err(Error::EmptyMesh(_)) if blocks > 1 => return Ok(Made::empty(own.len())),
        welded => welded?,
    };
    let mended = Mended::new(&gathered, &mesh, &own, &all);
    drop(gathered);
    // Faces of others have made their parts of normals.
    let is_own = |row: &u32| own.binary_search(&all[*row as usize]).is_ok();
    let kept: Vec<usize> = (0..mesh.faces.len()).filter(|f| is_own(&mesh.face_rows[*f])).collect();
    let rows: Vec<u32> = kept.iter().map(|f| all[mesh.face_rows[*f] as usize]).collect();
    mesh.faces = kept.iter().map(|f| mesh.faces[*f]).collect();
    drop(kept);
    let mut content = Content::new(&mesh, common.computed_normals, common.options);
    let store = VertexStore::new(&mut mesh);
    let source_cluster = |mut mesh: ClusterMesh| {
        // Rows of faces follow its triangles.
        order::spiral(&mut mesh);
        BuildCluster::of_source(mesh, &store.positions)
    };
    let clusters: Vec<BuildCluster> = clusterize(&store, &mesh.faces, &mesh.materials, common.options)
        .into_par_iter()
        .map(source_cluster)
        .collect();
    content.set_source(&store, &clusters);
    if !meter.advance(mesh.faces.len()) {
        return Err(Error::Cancelled);
    }
    let face_rows = common.options.face_ids.then(|| {
        let names: Vec<u32> = (0..store.count() as u32).collect();
        let ids = face_ids(clusters.iter(), &mesh.faces, &rows, &names);
        let mut rest = ids.as_slice();
        let of = |cluster: &BuildCluster| {
            let (own, behind) = rest.split_at(cluster.mesh.triangles.len());
            rest = behind;
            own.to_vec()
        };
        clusters.iter().map(of).collect()
    });
    let faces = mesh.faces.len() as u64;
    let fixed = bits_of(&lists::read(folder, BORDER, block)?);
    let share = common.source_faces as f64 / faces.max(1) as f64;
    let enough = enough(faces, LEFT_OF_SOURCE, &fixed);
    let part = (blocks > 1).then_some(Part { fixed, enough, share, stalled: false });
    let start = Start {
        content,
        store,
        clusters,
        is_source: true,
        level: 0,
        part,
        silhouette: common.silhouette,
        source_faces: common.source_faces,
    };
    let grown = grow_from(start, common.options, meter, &mut report)?;
    let mut made = write(grown, &mesh.channels, face_rows.unwrap_or_default(), path, report, Vec::new(), 0)?;
    made.summary.mended = mended;
    Ok(made)
}

/// Positions by their bits, which follow each other.
pub fn bits_of(words: &[u32]) -> FxHashSet<[u32; 3]> {
    words.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
}

/// A cluster that a block of the stage before left.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Taken {
    /// The block.
    pub block: u32,
    /// Where it lies.
    pub place: Place,
}

/// Grows further levels over what is left of several blocks. A part has positions that others share, and triangles of all parts
/// together. `first_group` has the number of the first group of each block of the stage before.
pub fn of_left(
    taken: &[Taken],
    readers: &[SpoolReader],
    first_group: &[u32],
    part: Option<(FxHashSet<[u32; 3]>, u64)>,
    level: u32,
    common: &Common<'_>,
    path: PathBuf,
    meter: &Meter<'_>,
) -> Result<Made> {
    let mut store = VertexStore { stride: common.stride, layout: common.layout, ..VertexStore::default() };
    let (infos, scales) = (common.channels.to_vec(), common.scales.to_vec());
    let mut channels = Channels { infos, scales, words: Vec::new() };
    let width = channels.width();
    let (mut clusters, mut face_rows) = (Vec::new(), Vec::new());
    let mut of_identity: FxHashMap<(u32, u32), u32> = FxHashMap::default();
    // Blocks that share a vertex have it each: positions, attributes and channels are the same.
    let mut of_bits: FxHashMap<Vec<u32>, Vec<(u32, u32)>> = FxHashMap::default();
    let mut origins = Vec::new();
    for Taken { block, place } in taken {
        let record = readers[*block as usize].read(*place)?;
        let mut names = Vec::with_capacity(record.ids.len());
        for (v, id) in record.ids.iter().enumerate() {
            let name = *of_identity.entry((*block, *id)).or_insert_with(|| {
                let (position, row) = (record.store.positions[v], record.store.row(v as u32));
                let words = &record.words[v * width..][..width];
                let floats = position.iter().chain(row).map(|x| x.to_bits());
                let bits = floats.chain(words.iter().copied()).collect();
                let same = of_bits.entry(bits).or_default();
                // Two of one block are two.
                let known = same.iter().map(|(name, _)| *name).find(|name| !same.contains(&(*name, *block)));
                let name = known.unwrap_or(store.positions.len() as u32);
                if known.is_none() {
                    store.positions.push(position);
                    store.attributes.extend_from_slice(row);
                    channels.words.extend_from_slice(words);
                }
                same.push((name, *block));
                origins.push([name, *block, *id]);
                name
            });
            names.push(name);
        }
        for (mut cluster, rows) in record.clusters.into_iter().zip(record.face_rows) {
            cluster.mesh.vertices.iter_mut().for_each(|v| *v = names[*v as usize]);
            cluster.refined = group_number(cluster.refined, first_group[*block as usize]);
            clusters.push(cluster);
            face_rows.push(rows);
        }
    }
    let mut report = BuildReport::default();
    let triangles: u64 = clusters.iter().map(|c: &BuildCluster| c.mesh.triangles.len() as u64).sum();
    let faces: Vec<[u32; 3]> = clusters
        .iter()
        .flat_map(|c| c.mesh.triangles.iter().map(|t| t.map(|v| c.mesh.vertices[usize::from(v)])))
        .collect();
    store.labels = channels.label_numbers();
    let mut content =
        Content::of(common.layout, common.channels, common.computed_normals, &weights(common.options))
            .over(&store.positions, &faces);
    content.set_source(&store, &clusters);
    drop(faces);
    let start = Start {
        content,
        store,
        clusters,
        is_source: false,
        level,
        part: part.map(|(fixed, whole)| Part {
            enough: enough(triangles, LEFT, &fixed),
            fixed,
            share: whole as f64 / triangles.max(1) as f64,
            stalled: false,
        }),
        silhouette: common.silhouette,
        source_faces: common.source_faces,
    };
    let grown = grow_from(start, common.options, meter, &mut report)?;
    write(grown, &channels, face_rows, path, report, origins, level)
}

/// Writes what has grown.
fn write(
    grown: Grown,
    channels: &Channels,
    face_rows: Vec<Vec<u32>>,
    path: PathBuf,
    report: BuildReport,
    origins: Vec<[u32; 3]>,
    level: u32,
) -> Result<Made> {
    let Grown { store, mut clusters, groups, pending } = grown;
    let bounds = |c: u32| {
        let vertices = &clusters[c as usize].mesh.vertices;
        Aabb::of_points(vertices.iter().map(|v| &store.positions[*v as usize]))
    };
    let boxes: Vec<Aabb> = (0..clusters.len() as u32).map(bounds).collect();
    let rows = |c: u32| face_rows.get(c as usize).map_or(&[][..], Vec::as_slice);
    let words = channels.finish_rows(&store.attributes, store.stride, &store.labels);
    let mut out = SpoolWriter::create(path)?;
    let mut left = Vec::with_capacity(pending.len());
    for c in pending {
        let cluster = &clusters[c as usize];
        let place = out.write(&store, &words, std::iter::once((cluster, rows(c))))?;
        let triangles = cluster.mesh.triangles.len() as u32;
        left.push(LeftEntry { triangles, bounds: boxes[c as usize], place });
    }
    let next = groups.iter().map(|group| group.level + 1).max().unwrap_or(level);
    let mut entries = Vec::with_capacity(groups.len());
    for mut group in groups {
        let members = std::mem::take(&mut group.members);
        for c in &members {
            let cluster = &mut clusters[*c as usize];
            // Those of the source are in that order.
            if cluster.level > 0 {
                order::spiral(&mut cluster.mesh);
            }
        }
        let own = members.iter().map(|c| &clusters[*c as usize]);
        let of_source = own.clone().filter(|cluster| cluster.level == 0);
        entries.push(GroupEntry {
            lod_sphere: group.lod_sphere,
            error: group.error,
            bound: group.bound,
            quadric: group.quadric,
            attribute_error: group.attribute_error,
            rank: group.rank,
            level: group.level,
            clusters: members.len() as u32,
            faces: of_source.map(|cluster| cluster.mesh.triangles.len() as u32).sum(),
            bounds: members.iter().fold(Aabb::EMPTY, |b, c| b.union(&boxes[*c as usize])),
            min_own_error: own.clone().map(|cluster| cluster.error).fold(f32::INFINITY, f32::min),
            place: out.write(&store, &words, own.zip(members.iter().map(|c| rows(*c))))?,
        });
    }
    out.finish()?;
    let of_source = boxes.iter().zip(&clusters).filter(|(_, cluster)| cluster.level == 0);
    let bounds = of_source.fold(Aabb::EMPTY, |all, (of, _)| all.union(of));
    let summary = Summary {
        identities: store.count() as u32,
        report,
        bounds: (bounds.min[0] <= bounds.max[0]).then_some([bounds.min, bounds.max]),
        mended: Mended::default(),
        levels: level..next,
    };
    Ok(Made { groups: entries, left, origins, summary })
}

impl Made {
    /// Of a block none of whose faces stays.
    fn empty(faces: usize) -> Self {
        let mut made = Self::default();
        made.summary.mended.degenerate_faces = faces as u64;
        made
    }

    /// Writes it, in one step: a block is made where its file is there.
    pub fn write(&self, path: &Path) -> Result<()> {
        // A struct of numbers always has a JSON form.
        let mut summary = serde_json::to_vec(&self.summary).unwrap_or_default();
        summary.resize(summary.len().next_multiple_of(size_of::<u32>()), b' ');
        let lengths = [summary.len() / 4, self.groups.len(), self.left.len(), self.origins.len()];
        let head = lengths.map(|length| length as u32);
        let parts: [&[u8]; 5] = [
            bytemuck::cast_slice(&head),
            &summary,
            bytemuck::cast_slice(&self.groups),
            bytemuck::cast_slice(&self.left),
            bytemuck::cast_slice(&self.origins),
        ];
        lists::write_whole(path, &parts)
    }

    /// Reads what was written; nothing where it was not.
    pub fn read(path: &Path) -> Result<Option<Self>> {
        let Some(words) = lists::words_of(path)? else { return Ok(None) };
        let broken = || Error::Invariant(format!("{}: what a block made is cut short", path.display()));
        let mut rest = words.as_slice();
        let mut take = |count: usize| -> Result<&[u32]> {
            let (first, behind) = rest.split_at_checked(count).ok_or_else(broken)?;
            rest = behind;
            Ok(first)
        };
        let head = take(4)?;
        let [summary, groups, left, origins] = [0, 1, 2, 3].map(|k| head[k] as usize);
        let summary: &[u8] = bytemuck::cast_slice(take(summary)?);
        Ok(Some(Self {
            summary: serde_json::from_slice(summary).map_err(|_| broken())?,
            groups: bytemuck::cast_slice(take(groups * size_of::<GroupEntry>() / 4)?).to_vec(),
            left: bytemuck::cast_slice(take(left * size_of::<LeftEntry>() / 4)?).to_vec(),
            origins: bytemuck::cast_slice(take(origins * 3)?).to_vec(),
        }))
    }
}

/// What was mended in a block of the source, and what edges are like: each counted in one block alone.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Mended {
    /// Faces that stay.
    pub faces: u64,
    /// Faces with two corners at one position.
    pub degenerate_faces: u64,
    /// Faces that were there before.
    pub duplicate_faces: u64,
    /// Edges with one face.
    pub border_edges: u64,
    /// For numbers of faces above two, how many uses of an edge by a face of the block have so many at the edge.
    pub crowded: BTreeMap<u32, u64>,
}

impl Mended {
    /// `own` has the rows of the block's faces and `all` those that were gathered.
    fn new(gathered: &Gathered, mesh: &WeldedMesh, own: &[u32], all: &[u32]) -> Self {
        let is_own = |row: usize| own.binary_search(&all[row]).is_ok();
        let degenerate = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| gathered.positions[v as usize]);
            a == b || b == c || c == a
        };
        let dropped =
            gathered.faces.iter().enumerate().filter(|(row, face)| is_own(*row) && degenerate(face));
        let degenerate_faces = dropped.count() as u64;
        let ids = hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3);
        let edges = Edges::named(&mesh.faces, |v| ids[v as usize]);
        let mut out = Self { degenerate_faces, ..Self::default() };
        let kept = mesh.faces.iter().zip(&mesh.face_rows).filter(|(_, row)| is_own(**row as usize));
        for (face, _) in kept {
            out.faces += 1;
            for k in 0..3 {
                let [a, b] = [face[k], face[(k + 1) % 3]].map(|v| ids[v as usize]);
                let ends = (a.min(b), a.max(b));
                let Some(edge) = edges.at(ends.0).find(|edge| edge.ends == ends) else { continue };
                match edge.faces() {
                    1 => out.border_edges += 1,
                    2 => {}
                    faces => *out.crowded.entry(faces).or_default() += 1,
                }
            }
        }
        out.duplicate_faces = own.len() as u64 - out.faces - degenerate_faces;
        out
    }
}

/// Some faces of a source with the vertices that they use.
struct Gathered {
    positions: Vec<[f32; 3]>,
    faces: Vec<[u32; 3]>,
    normals: Option<Vec<[f32; 3]>>,
    colors: Option<OwnColors>,
    uvs: Vec<Vec<[f32; 2]>>,
    channels: Vec<(ChannelInfo, Vec<u32>)>,
    materials: Option<Vec<i32>>,
}

enum OwnColors {
    U8(Vec<[u8; 4]>),
    U16(Vec<[u16; 4]>),
    F32(Vec<[f32; 4]>),
}

impl Gathered {
    fn new(source: &SourceMesh<'_>, rows: &[u32], frame: &CoordinateFrame) -> Self {
        let corners = |row: &u32| source.faces[*row as usize];
        let mut vertices: Vec<u32> = rows.iter().flat_map(corners).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let local = |v: u32| vertices.partition_point(|w| *w < v) as u32;
        fn of<T: Copy>(all: &[T], rows: &[u32]) -> Vec<T> {
            rows.iter().map(|v| all[*v as usize]).collect()
        }
        let words = |channel: &SourceChannel<'_>| {
            let width = channel.info.width();
            vertices.iter().flat_map(|v| &channel.words[*v as usize * width..][..width]).copied().collect()
        };
        Self {
            positions: vertices
                .iter()
                .map(|v| frame::internal(frame, source.positions.get(*v as usize)))
                .collect(),
            faces: rows.iter().map(|row| corners(row).map(local)).collect(),
            normals: source.normals.map(|all| of(all, &vertices)),
            colors: source.colors.map(|colors| match colors {
                Colors::U8(all) => OwnColors::U8(of(all, &vertices)),
                Colors::U16(all) => OwnColors::U16(of(all, &vertices)),
                Colors::F32(all) => OwnColors::F32(of(all, &vertices)),
            }),
            uvs: source.uvs.iter().map(|all| of(all, &vertices)).collect(),
            channels: source.channels.iter().map(|of| (of.info.clone(), words(of))).collect(),
            materials: source.materials.map(|all| of(all, rows)),
        }
    }

    fn mesh(&self) -> SourceMesh<'_> {
        SourceMesh {
            positions: Positions::F32(&self.positions),
            faces: &self.faces,
            normals: self.normals.as_deref(),
            colors: self.colors.as_ref().map(|colors| match colors {
                OwnColors::U8(rows) => Colors::U8(rows),
                OwnColors::U16(rows) => Colors::U16(rows),
                OwnColors::F32(rows) => Colors::F32(rows),
            }),
            uvs: self.uvs.iter().map(Vec::as_slice).collect(),
            channels: self
                .channels
                .iter()
                .map(|(info, words)| SourceChannel { info: info.clone(), words })
                .collect(),
            materials: self.materials.as_deref(),
        }
    }
}
