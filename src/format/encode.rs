//! A mesh as bytes.

use serde::{Deserialize, Serialize};

use super::file::{ALIGNMENT, ENTRY_BYTES, HEADER_BYTES, Kind, MAGIC, VERSION};
use crate::model::{AttributeLayout, BuildReport, ChannelInfo, Dag, Frame};

/// The metadata section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metadata {
    /// What wrote the file.
    pub generator: String,
    /// Internal to object space.
    pub frame: Frame,
    /// Smallest and largest corner of the source, internal units.
    pub bounds: [[f32; 3]; 2],
    /// Streams of every cluster.
    pub layout: AttributeLayout,
    /// Number of vertex identities.
    pub vertex_count: u32,
    /// Name, type and width of each channel.
    pub channels: Vec<ChannelInfo>,
    /// Triangles of the source after mending.
    pub source_faces: u64,
    /// Vertices of the source after welding.
    pub source_vertices: u64,
    /// What building did.
    pub report: BuildReport,
}

/// Serializes a mesh. The same mesh gives the same bytes.
pub fn to_bytes(dag: &Dag) -> Vec<u8> {
    let metadata = Metadata {
        generator: concat!("nanite_rs ", env!("CARGO_PKG_VERSION")).into(),
        frame: dag.frame,
        bounds: [dag.bounds.min, dag.bounds.max],
        layout: dag.layout(),
        vertex_count: dag.vertex_count,
        channels: dag.channels.iter().map(|c| c.info.clone()).collect(),
        source_faces: dag.source_faces,
        source_vertices: dag.source_vertices,
        report: dag.report.clone(),
    };
    // A struct of numbers and strings always has a JSON form.
    let json = serde_json::to_vec_pretty(&metadata).unwrap_or_default();
    let mut sections: Vec<(Kind, &[u8])> = vec![
        (Kind::Metadata, &json),
        (Kind::Groups, bytemuck::cast_slice(&dag.groups)),
        (Kind::Nodes, bytemuck::cast_slice(&dag.nodes)),
        (Kind::PageTable, bytemuck::cast_slice(&dag.pages.table)),
        (Kind::Pages, bytemuck::cast_slice(&dag.pages.words)),
    ];
    if let Some(rows) = &dag.face_ids {
        sections.push((Kind::FaceIds, bytemuck::cast_slice(rows)));
    }
    let channels: Vec<u32> = dag.channels.iter().flat_map(|c| &c.words).copied().collect();
    if !dag.channels.is_empty() {
        sections.push((Kind::Channels, bytemuck::cast_slice(&channels)));
    }
    let mut table = Vec::new();
    let mut offset = (HEADER_BYTES + sections.len() * ENTRY_BYTES).next_multiple_of(ALIGNMENT);
    for (kind, data) in &sections {
        table.extend_from_slice(&(*kind as u32).to_le_bytes());
        table.extend_from_slice(&crc32fast::hash(data).to_le_bytes());
        table.extend_from_slice(&(offset as u64).to_le_bytes());
        table.extend_from_slice(&(data.len() as u64).to_le_bytes());
        table.extend_from_slice(&[0; 8]);
        offset = (offset + data.len()).next_multiple_of(ALIGNMENT);
    }
    let mut out = Vec::with_capacity(offset);
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&(sections.len() as u32).to_le_bytes());
    out.extend_from_slice(&crc32fast::hash(&table).to_le_bytes());
    out.extend_from_slice(&crc32fast::hash(&out).to_le_bytes());
    out.extend_from_slice(&table);
    for (_, data) in &sections {
        out.resize(out.len().next_multiple_of(ALIGNMENT), 0);
        out.extend_from_slice(data);
    }
    out
}
