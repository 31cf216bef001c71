//! Grown groups on disk: each as one record with the vertices of its clusters, so that whoever lays out pages reads nothing
//! else. What a block leaves for the next stage is one such record for each cluster.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use bytemuck::{Pod, Zeroable};
use rustc_hash::FxHashMap;

use super::lists::Aside;
use crate::build::clusterize::ClusterMesh;
use crate::build::dag::BuildCluster;
use crate::build::reference::Pieces;
use crate::build::store::VertexStore;
use crate::error::{Error, Result};
use crate::math::Sphere;
use crate::model::AttributeLayout;

/// Words of a cluster before its lists.
const HEAD: usize = 16;

/// Where a record lies in the file of its block.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct Place {
    /// In words: the lower half of the number, and the upper one.
    offset: [u32; 2],
    words: u32,
}

impl Place {
    fn new(offset: u64, words: u32) -> Self {
        Self { offset: [offset as u32, (offset >> 32) as u32], words }
    }

    /// In words.
    fn offset(self) -> u64 {
        u64::from(self.offset[0]) | u64::from(self.offset[1]) << 32
    }
}

/// Clusters with vertices of their own.
#[derive(Debug, Default)]
pub struct Record {
    /// The vertices that the clusters name.
    pub store: VertexStore,
    /// The identity of each in its block.
    pub ids: Vec<u32>,
    /// The words of channels of each, one vertex after the other.
    pub words: Vec<u32>,
    /// The clusters.
    pub clusters: Vec<BuildCluster>,
    /// Of each cluster the rows of its triangles in the caller's faces; empty where nobody asked for them, or it is not of the
    /// source.
    pub face_rows: Vec<Vec<u32>>,
}

/// Writes the records of a block.
pub struct SpoolWriter {
    path: PathBuf,
    aside: Aside,
    out: BufWriter<File>,
    end: u64,
    words: Vec<u32>,
}

impl SpoolWriter {
    /// Into a new file.
    pub fn create(path: PathBuf) -> Result<Self> {
        let aside = Aside::create(&path)?;
        let file = aside.file().try_clone().map_err(|source| Error::Io { path: path.clone(), source })?;
        Ok(Self { path, aside, out: BufWriter::new(file), end: 0, words: Vec::new() })
    }

    /// Writes some clusters of a store as a record; `channels` has the words of channels of all its vertices.
    pub fn write<'a>(
        &mut self,
        store: &VertexStore,
        channels: &[u32],
        clusters: impl ExactSizeIterator<Item = (&'a BuildCluster, &'a [u32])>,
    ) -> Result<Place> {
        let width = channels.len() / store.count().max(1);
        let words = &mut self.words;
        words.clear();
        words.push(clusters.len() as u32);
        for (cluster, rows) in clusters {
            let mesh = &cluster.mesh;
            let radii = cluster.pieces.radii();
            let sphere = cluster.lod_sphere;
            let [x, y, z] = sphere.center;
            words.extend([
                mesh.vertices.len() as u32,
                mesh.triangles.len() as u32,
                radii.len() as u32,
                rows.len() as u32,
                mesh.material,
                u32::from(cluster.level),
                cluster.refined,
            ]);
            let numbers =
                [cluster.error, cluster.bound, cluster.quadric, cluster.attribute_error, cluster.rank];
            words.extend(numbers.iter().chain(&[x, y, z, sphere.radius]).map(|x| x.to_bits()));
            words.extend(&mesh.vertices);
            for v in &mesh.vertices {
                words.extend(store.positions[*v as usize].map(f32::to_bits));
                words.extend(store.row(*v).iter().map(|x| x.to_bits()));
                words.extend(&channels[*v as usize * width..][..width]);
            }
            words.extend(mesh.triangles.iter().map(|[a, b, c]| u32::from_le_bytes([*a, *b, *c, 0])));
            words.extend(radii.iter().map(|x| x.to_bits()));
            words.extend(rows);
        }
        let place = Place::new(self.end, words.len() as u32);
        self.end += words.len() as u64;
        let written = self.out.write_all(bytemuck::cast_slice(words));
        written.map_err(|source| Error::Io { path: self.path.clone(), source })?;
        Ok(place)
    }

    /// After the last record.
    pub fn finish(mut self) -> Result<()> {
        self.out.flush().map_err(|source| Error::Io { path: self.path, source })?;
        self.aside.finish()
    }
}

/// Reads the records of a block. Files are open for as long as it takes: there are many.
#[derive(Debug)]
pub struct SpoolReader {
    path: PathBuf,
    layout: AttributeLayout,
    stride: usize,
    width: usize,
}

impl SpoolReader {
    /// Of vertices with rows of `stride` floats, and `width` words of channels.
    pub fn new(path: &Path, layout: AttributeLayout, stride: usize, width: usize) -> Self {
        Self { path: path.to_path_buf(), layout, stride, width }
    }

    /// Reads a record. Vertices come in the order of their first use.
    pub fn read(&self, place: Place) -> Result<Record> {
        let mut words = vec![0u32; place.words as usize];
        let offset = place.offset() * size_of::<u32>() as u64;
        let file = File::open(&self.path);
        file.and_then(|file| read_at(&file, bytemuck::cast_slice_mut(&mut words), offset))
            .map_err(|source| Error::Io { path: self.path.clone(), source })?;
        let broken = || Error::Invariant(format!("{}: a record is cut short", self.path.display()));
        let mut record = Record {
            store: VertexStore { stride: self.stride, layout: self.layout, ..VertexStore::default() },
            ..Record::default()
        };
        let mut known: FxHashMap<u32, u32> = FxHashMap::default();
        let (floats, row) = (3 + self.stride, 3 + self.stride + self.width);
        let mut rest = words.as_slice();
        let count = take(&mut rest, 1).ok_or_else(broken)?[0];
        for _ in 0..count {
            let head = take(&mut rest, HEAD).ok_or_else(broken)?;
            let [vertices, triangles, radii, rows] = [0, 1, 2, 3].map(|k| head[k] as usize);
            let float = |k: usize| f32::from_bits(head[k]);
            let ids = take(&mut rest, vertices).ok_or_else(broken)?;
            let values = take(&mut rest, vertices * row).ok_or_else(broken)?;
            let corners = take(&mut rest, triangles).ok_or_else(broken)?;
            let radii = take(&mut rest, radii).ok_or_else(broken)?;
            let rows = take(&mut rest, rows).ok_or_else(broken)?;
            let mut own = Vec::with_capacity(vertices);
            for (id, values) in ids.iter().zip(values.chunks_exact(row)) {
                own.push(*known.entry(*id).or_insert_with(|| {
                    let store = &mut record.store;
                    let (values, channels) = values.split_at(floats);
                    let values: &[f32] = bytemuck::cast_slice(values);
                    store.positions.push([values[0], values[1], values[2]]);
                    store.attributes.extend_from_slice(&values[3..]);
                    record.words.extend_from_slice(channels);
                    record.ids.push(*id);
                    record.ids.len() as u32 - 1
                }));
            }
            let triangle = |word: &u32| {
                let [a, b, c, _] = word.to_le_bytes();
                [a, b, c]
            };
            record.clusters.push(BuildCluster {
                mesh: ClusterMesh {
                    vertices: own,
                    triangles: corners.iter().map(triangle).collect(),
                    material: head[4],
                },
                level: head[5] as u8,
                refined: head[6],
                error: float(7),
                bound: float(8),
                quadric: float(9),
                attribute_error: float(10),
                rank: float(11),
                lod_sphere: Sphere { center: [float(12), float(13), float(14)], radius: float(15) },
                pieces: Pieces::of_radii(radii.iter().map(|x| f32::from_bits(*x)).collect()),
            });
            record.face_rows.push(rows.to_vec());
        }
        Ok(record)
    }
}

/// The first words of some, which then begin behind them.
fn take<'a>(rest: &mut &'a [u32], count: usize) -> Option<&'a [u32]> {
    let (first, behind) = rest.split_at_checked(count)?;
    *rest = behind;
    Some(first)
}

/// All bytes from an offset on.
pub fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> std::io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset);
    #[cfg(not(unix))]
    {
        use std::io::{Read, Seek, SeekFrom};
        let mut file = file.try_clone()?;
        file.seek(SeekFrom::Start(offset))?;
        file.read_exact(bytes)
    }
}
