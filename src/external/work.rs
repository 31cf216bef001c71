//! The folder of a build: a manifest, and for each block what it is given and what it made. Whatever is there is whole, so a
//! build that was stopped goes on from its last finished block, and any process that sees the folder may make a block.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};
use serde::{Deserialize, Serialize};

use super::assemble::{Stages, assemble, too_many};
use super::block::{Common, LeftEntry, Made, Taken, bits_of, of_left, of_source};
use super::cells::{Blocks, Cells};
use super::lists::{self, write_whole};
use super::report::{Input, report};
use super::source::{AROUND, BORDER, OWN, distribute, silhouette, used};
use super::spool::SpoolReader;
use crate::build::Meter;
use crate::build::memory::trim_heap;
use crate::build::silhouette::Silhouette;
use crate::config::{BuildOptions, Levels};
use crate::error::{Error, Result};
use crate::math::Aabb;
use crate::mesh::channels::{self, Scale, scales_of};
use crate::mesh::{SourceMesh, attributes, frame, validate};
use crate::model::{AttributeLayout, ChannelInfo, CoordinateFrame, Dag};

/// Bytes that building in memory takes for each triangle of the source, without its arrays,
const BYTES_PER_TRIANGLE: u64 = 120;
/// for each vertex,
const BYTES_PER_VERTEX: u64 = 60;
/// for each float of its attributes,
const BYTES_PER_FLOAT: u64 = 9;
/// and for each triangle where vertices have labels, which are looked up on the source; all a tenth to a third above what was
/// measured.
const BYTES_PER_LABELLED: u64 = 28;
/// Fewer triangles are no block.
const LEAST_TRIANGLES: u64 = 4096;
/// By how much of its side the grid of each stage is shifted against the one before: the golden ratio repeats nothing soon.
const SHIFT: f64 = 0.618_033_988_749_895;
/// Where a stage leaves more than this part of what it was given, the next takes larger blocks.
const STALLED: f64 = 0.7;
/// The folder in that of the build which has all files that are named here.
const BLOCKS: &str = "blocks";
/// The name of the manifest.
const MANIFEST: &str = "manifest.json";
/// Grows whenever folders of before cannot be gone on with.
const VERSION: u32 = 2;

/// What is known of a build once its source is in blocks.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Manifest {
    version: u32,
    /// What is built, and how: a folder of something else is not gone on with.
    key: String,
    frame: CoordinateFrame,
    layout: AttributeLayout,
    channels: Vec<ChannelInfo>,
    scales: Vec<Scale>,
    computed_normals: bool,
    /// Where area is preserved.
    silhouette: Option<Silhouette>,
    input: Input,
    /// Triangles of a block at most.
    most: u64,
    stages: Vec<Stage>,
}

/// A stage of blocks.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Stage {
    blocks: usize,
    /// The first level that it makes.
    level: u32,
    /// Triangles that it is given.
    triangles: u64,
}

/// Bytes that building a source in memory takes beyond its arrays, about.
pub fn memory_of(source: &SourceMesh<'_>) -> u64 {
    // Channels are words of the source, and floats of which rows have more.
    let channels: usize = source.channels.iter().map(|channel| channel.info.width()).sum();
    let floats = attributes::stride(attributes::layout(source)) + channels;
    let per_vertex = BYTES_PER_VERTEX + BYTES_PER_FLOAT * floats as u64;
    let labelled = source.channels.iter().any(|channel| channel.info.dtype.is_label());
    let per_triangle = BYTES_PER_TRIANGLE + if labelled { BYTES_PER_LABELLED } else { 0 };
    source.faces.len() as u64 * per_triangle + source.positions.len() as u64 * per_vertex
}

/// A build in blocks.
#[derive(Debug)]
pub struct Work {
    folder: PathBuf,
    options: BuildOptions,
    manifest: Manifest,
}

impl Work {
    /// Goes on with what is in a folder, where that is this build, or else puts the source into blocks. `key` tells sources
    /// apart.
    pub fn begin(
        source: &SourceMesh<'_>,
        options: &BuildOptions,
        memory: u64,
        folder: &Path,
        key: &str,
    ) -> Result<Self> {
        options.validate()?;
        // Blocks find in later stages what they have in common.
        if options.levels == Levels::One {
            return Err(Error::argument("memory", "one level is built in memory alone"));
        }
        let key = format!("{key} {memory} {:?}", BuildOptions { threads: 0, ..options.clone() });
        let folder = folder.join(BLOCKS);
        if let Some(manifest) = read_manifest(&folder)?
            && manifest.key == key
            && manifest.version == VERSION
        {
            return Ok(Self { folder, options: options.clone(), manifest });
        }
        validate::validate(source)?;
        // Nothing of another build stays, nor of one that was stopped before it had a manifest.
        emptied(&folder).map_err(|source| Error::Io { path: folder.clone(), source })?;
        let referenced = frame::referenced(source.faces, source.positions.len());
        let frame = frame::of(source.positions, &referenced);
        let place = |v: usize| Aabb::of_points([&frame::internal(&frame, source.positions.get(v))]);
        let around = (0..referenced.len()).into_par_iter().filter(|v| referenced[*v]).map(place);
        let around = around.reduce(|| Aabb::EMPTY, |a, b| a.union(&b));
        drop(referenced);
        let part = memory as f64 / memory_of(source).max(1) as f64;
        let most = ((part * source.faces.len() as f64) as u64).max(LEAST_TRIANGLES);
        let used = used(source, &frame);
        let blocks = distribute(source, &frame, &Cells::new(&around, 0.0), most, &folder)?;
        let work = Self {
            folder,
            options: options.clone(),
            manifest: Manifest {
                version: VERSION,
                key,
                frame,
                layout: attributes::layout(source),
                channels: source.channels.iter().map(|channel| channel.info.clone()).collect(),
                scales: scales_of(source, &used),
                computed_normals: source.normals.is_none(),
                silhouette: options.preserve_area.then(|| silhouette(source, &frame, &used)),
                input: Input::of(source, &used),
                most,
                stages: vec![Stage { blocks, level: 0, triangles: source.faces.len() as u64 }],
            },
        };
        work.write_manifest()?;
        Ok(work)
    }

    /// What another process began.
    pub fn open(folder: &Path, options: &BuildOptions) -> Result<Self> {
        let folder = folder.join(BLOCKS);
        let manifest = read_manifest(&folder)?;
        let missing = || Error::argument("folder", format!("{}: nothing was begun here", folder.display()));
        let manifest = manifest.ok_or_else(missing)?;
        Ok(Self { folder, options: options.clone(), manifest })
    }

    /// Where it writes.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn write_manifest(&self) -> Result<()> {
        // A struct of numbers and strings always has a JSON form.
        let bytes = serde_json::to_vec_pretty(&self.manifest).unwrap_or_default();
        write_whole(&self.folder.join(MANIFEST), &[&bytes])
    }

    /// The number of the current stage.
    pub fn stage(&self) -> usize {
        self.manifest.stages.len() - 1
    }

    /// Triangles that all blocks of the current stage together are given.
    pub fn triangles(&self) -> u64 {
        self.manifest.stages[self.stage()].triangles
    }

    /// Blocks of the current stage that are to be made.
    pub fn missing(&self) -> Vec<usize> {
        let blocks = self.manifest.stages[self.stage()].blocks;
        (0..blocks).filter(|block| !self.path(self.stage(), *block, "made").exists()).collect()
    }

    fn path(&self, stage: usize, block: usize, what: &str) -> PathBuf {
        self.folder.join(format!("stage{stage}-{block:06}.{what}"))
    }

    /// Files that making a block of the current stage reads, by their names in the folder of the build: first what says which
    /// others, then those that it says.
    pub fn inputs(&self, block: usize) -> Result<[Vec<String>; 2]> {
        let stage = self.stage();
        if stage == 0 {
            let lists = [OWN, AROUND, BORDER].map(|name| lists::path(Path::new(BLOCKS), name, block));
            return Ok([Vec::new(), lists.iter().map(|path| path.display().to_string()).collect()]);
        }
        let taken = self.path(stage, block, "taken");
        let given = [taken.clone(), self.path(stage, block, "fixed"), self.path(stage, 0, "groups")];
        let taken: Vec<Taken> = bytemuck::cast_slice(&lists::words_of(&taken)?.unwrap_or_default()).to_vec();
        let mut blocks: Vec<u32> = taken.iter().map(|taken| taken.block).collect();
        blocks.sort_unstable();
        blocks.dedup();
        let all: Vec<(usize, usize)> = self.blocks().collect();
        let records = blocks.iter().filter_map(|of| all.get(*of as usize));
        let records = records.map(|(stage, block)| self.path(*stage, *block, "records"));
        Ok([given.map(|path| name(&path)).to_vec(), records.map(|path| name(&path)).collect()])
    }

    /// Files that making a block of the current stage writes; the last one says that it is made.
    pub fn outputs(&self, block: usize) -> [String; 2] {
        ["records", "made"].map(|what| name(&self.path(self.stage(), block, what)))
    }

    /// The blocks of all stages: each by its stage and its number there.
    fn blocks(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let stages = self.manifest.stages.iter().enumerate();
        stages.flat_map(|(stage, of)| (0..of.blocks).map(move |block| (stage, block)))
    }

    fn common(&self) -> Common<'_> {
        let Manifest { frame, layout, channels, scales, computed_normals, input, .. } = &self.manifest;
        Common {
            frame: *frame,
            layout: *layout,
            stride: attributes::stride(*layout) + scales.len(),
            channels,
            scales,
            source_faces: input.faces as usize,
            computed_normals: *computed_normals,
            silhouette: self.manifest.silhouette,
            options: &self.options,
        }
    }

    /// Makes a block of the current stage.
    pub fn make(&self, source: &SourceMesh<'_>, block: usize, meter: &Meter<'_>) -> Result<()> {
        let stage = self.stage();
        let Stage { blocks, level, triangles } = self.manifest.stages[stage];
        let records = self.path(stage, block, "records");
        let common = self.common();
        let made = if stage == 0 {
            of_source(source, (block, blocks), &common, &self.folder, records, meter)?
        } else {
            let taken: Vec<Taken> = bytemuck::cast_slice(&given(&self.path(stage, block, "taken"))?).to_vec();
            let part = match blocks {
                1 => None,
                _ => Some((bits_of(&given(&self.path(stage, block, "fixed"))?), triangles)),
            };
            let first_group = given(&self.path(stage, 0, "groups"))?;
            of_left(&taken, &self.readers(), &first_group, part, level, &common, records, meter)?
        };
        made.write(&self.path(stage, block, "made"))?;
        trim_heap(self.manifest.input.faces as usize);
        Ok(())
    }

    /// For each block of all stages what reads its records.
    fn readers(&self) -> Vec<SpoolReader> {
        let Common { layout, stride, channels, .. } = self.common();
        let width = channels::width(channels);
        self.blocks()
            .map(|(stage, block)| {
                SpoolReader::new(&self.path(stage, block, "records"), layout, stride, width)
            })
            .collect()
    }

    /// What the blocks of all stages made, and the number of the first of each stage.
    fn all_made(&self) -> Result<(Vec<Made>, Vec<usize>)> {
        let (mut made, mut starts) = (Vec::new(), Vec::new());
        for (stage, Stage { blocks, .. }) in self.manifest.stages.iter().enumerate() {
            starts.push(made.len());
            for block in 0..*blocks {
                let path = self.path(stage, block, "made");
                let missing = || Error::Invariant(format!("{}: the block is not made", path.display()));
                made.push(Made::read(&path)?.ok_or_else(missing)?);
            }
        }
        Ok((made, starts))
    }

    /// Puts what the blocks of the current stage left into those of the next, which is the current one then; false where they
    /// left nothing.
    pub fn advance(&mut self) -> Result<bool> {
        let (all, starts) = self.all_made()?;
        let before = starts[self.stage()];
        let made = &all[before..];
        if self.stage() == 0 && made.iter().all(|made| made.summary.mended.faces == 0) {
            return Err(Error::EmptyMesh("no face is left once faces without area are dropped".into()));
        }
        let left = made.iter().flat_map(|made| &made.left).map(|left| u64::from(left.triangles));
        let triangles: u64 = left.sum();
        if triangles == 0 {
            return Ok(false);
        }
        if triangles as f64 > STALLED * self.triangles() as f64 {
            self.manifest.most *= 2;
        }
        let stage = self.stage() + 1;
        let taken = share_out(made, before as u32, stage, self.manifest.most);
        let fixed = shared(&taken, &self.readers())?;
        let first_group = first_groups(&all)?;
        write_whole(&self.path(stage, 0, "groups"), &[bytemuck::cast_slice(&first_group)])?;
        for (block, (taken, fixed)) in taken.iter().zip(fixed).enumerate() {
            write_whole(&self.path(stage, block, "taken"), &[bytemuck::cast_slice(taken)])?;
            let mut fixed: Vec<[u32; 3]> = fixed.into_iter().collect();
            fixed.sort_unstable();
            write_whole(&self.path(stage, block, "fixed"), &[bytemuck::cast_slice(&fixed)])?;
        }
        let level = made.iter().map(|made| made.summary.levels.end).max().unwrap_or(0);
        self.manifest.stages.push(Stage { blocks: taken.len(), level, triangles });
        self.write_manifest()?;
        Ok(true)
    }

    /// Lays out what all blocks made. The pages stay in the folder.
    pub fn finish(&self) -> Result<Dag> {
        let (made, starts) = self.all_made()?;
        let first_group = first_groups(&made)?;
        let summaries: Vec<_> = made.iter().map(|made| &made.summary).collect();
        let common = self.common();
        let report = report(&self.manifest.input, &summaries, &common);
        let faces = summaries.iter().map(|of| of.mended.faces).sum();
        let corners = summaries.iter().filter_map(|of| of.bounds).map(|[min, max]| Aabb { min, max });
        let bounds = corners.fold(Aabb::EMPTY, |all, of| all.union(&of));
        let readers = self.readers();
        let stages = Stages {
            made: &made,
            readers: &readers,
            starts: &starts,
            first_group: &first_group,
            common: &common,
        };
        assemble(&stages, bounds, faces, report, &self.folder)
    }
}

/// The name of a file of the blocks in the folder of the build.
fn name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    Path::new(BLOCKS).join(name).display().to_string()
}

/// The words of a file that is there.
fn given(path: &Path) -> Result<Vec<u32>> {
    let missing = || Error::Io { path: path.to_path_buf(), source: std::io::ErrorKind::NotFound.into() };
    lists::words_of(path)?.ok_or_else(missing)
}

/// The number of the first group of each block.
fn first_groups(made: &[Made]) -> Result<Vec<u32>> {
    let mut next = 0u32;
    let first = |made: &Made| {
        let first = next;
        let end = next.checked_add(made.groups.len() as u32).filter(|end| *end < 1 << 31);
        next = end.ok_or_else(|| too_many("groups"))?;
        Ok(first)
    };
    made.iter().map(first).collect()
}

/// Makes a folder, or empties it: first of the manifest, so that nobody takes the rest for whole.
fn emptied(folder: &Path) -> std::io::Result<()> {
    let unless_missing = |removed: std::io::Result<()>| match removed {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    };
    unless_missing(std::fs::remove_file(folder.join(MANIFEST)))?;
    unless_missing(std::fs::remove_dir_all(folder))?;
    std::fs::create_dir(folder)
}

fn read_manifest(folder: &Path) -> Result<Option<Manifest>> {
    let path = folder.join(MANIFEST);
    match std::fs::read(&path) {
        // What cannot be read is not gone on with.
        Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(Error::Io { path, source }),
    }
}

/// Puts what the blocks of a stage left into those of the next, by the centres of clusters; `first` is the number of the first
/// block of the stage.
fn share_out(made: &[Made], first: u32, next: usize, most: u64) -> Vec<Vec<Taken>> {
    let all =
        || (first..).zip(made).flat_map(|(block, made)| made.left.iter().map(move |left| (block, left)));
    let bounds = all().fold(Aabb::EMPTY, |bounds, (_, left)| bounds.union(&left.bounds));
    let cells = Cells::new(&bounds, (next as f64 * SHIFT).fract());
    let placed: Vec<(u32, u32, &LeftEntry)> =
        all().map(|(block, left)| (cells.of(left.bounds.center().map(f64::from)), block, left)).collect();
    let mut counts = vec![0; Cells::COUNT];
    placed.iter().for_each(|(cell, _, left)| counts[*cell as usize] += u64::from(left.triangles));
    let blocks = Blocks::new(&counts, most);
    let mut out = vec![Vec::new(); blocks.count];
    for (cell, block, left) in placed {
        out[blocks.of(cell) as usize].push(Taken { block, place: left.place });
    }
    out
}

/// For each block the positions that others have, too.
fn shared(taken: &[Vec<Taken>], readers: &[SpoolReader]) -> Result<Vec<FxHashSet<[u32; 3]>>> {
    let mut owners: FxHashMap<[u32; 3], u32> = FxHashMap::default();
    let mut out = vec![FxHashSet::default(); taken.len()];
    for (block, taken) in (0..).zip(taken) {
        for Taken { block: from, place } in taken {
            for p in readers[*from as usize].read(*place)?.store.positions {
                let bits = p.map(f32::to_bits);
                let owner = *owners.entry(bits).or_insert(block);
                if owner != block {
                    out[owner as usize].insert(bits);
                    out[block as usize].insert(bits);
                }
            }
        }
    }
    Ok(out)
}
