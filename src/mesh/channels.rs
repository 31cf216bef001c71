//! Named channels between the caller's arrays and the finished mesh: the exact words of the source, and the columns
//! that simplifiers work on. Floats are scaled by the range of their channel, so that weights have no unit. A label
//! is the number of the first source vertex with the same labels, so that a simplified vertex always has the labels
//! of one source vertex.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::hash;
use super::source::{SourceChannel, SourceMesh};
use crate::error::Result;
use crate::model::{Channel, ChannelInfo};

/// The channels of a mesh.
#[derive(Clone, Debug, Default)]
pub struct Channels {
    /// Name, type and width of each.
    pub infos: Vec<ChannelInfo>,
    /// For each source vertex the words of all channels, one after the other.
    pub words: Vec<u32>,
    /// Of each floating-point column.
    pub scales: Vec<Scale>,
}

/// How a column is scaled.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Scale {
    low: f64,
    high: f64,
    /// The largest range of any column of the channel: vectors keep their direction.
    range: f64,
}

impl Scale {
    /// Of the columns of a channel, from their least and largest values.
    fn of_channel(columns: &[(f64, f64)]) -> impl Iterator<Item = Self> {
        let range = columns.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
        columns.iter().map(move |&(low, high)| Self { low, high, range })
    }

    /// The scaled value of a word.
    pub fn scaled(&self, word: u32) -> f32 {
        let x = f64::from(f32::from_bits(word));
        if self.range > 0.0 { ((x - self.low) / self.range) as f32 } else { 0.0 }
    }

    /// The word of a scaled value. Solved values may leave the range of the source by a little.
    pub fn word(&self, x: f32) -> u32 {
        ((self.low + self.range * f64::from(x)).clamp(self.low, self.high) as f32).to_bits()
    }
}

/// How the floats of a finished mesh were scaled, a column after the other; reads those channels. Made vertices stay within
/// the ranges of the source, which is all there.
pub fn scales(channels: &[Channel]) -> Result<Vec<Scale>> {
    let mut scales = Vec::new();
    for channel in channels.iter().filter(|channel| !channel.info.dtype.is_label()) {
        let width = channel.info.width();
        scales.extend(Scale::of_channel(&ranges(channel.words.load()?, width)));
    }
    Ok(scales)
}

/// The same of a source, from those of its vertices that `used` has.
pub fn scales_of(source: &SourceMesh<'_>, used: &[bool]) -> Vec<Scale> {
    let floats = source.channels.iter().filter(|channel| !channel.info.dtype.is_label());
    let of = |channel: &SourceChannel<'_>| {
        let width = channel.info.width();
        let rows = channel.words.par_chunks(width).zip(used).filter(|(_, used)| **used);
        Scale::of_channel(&ranges_of(rows.map(|(row, _)| row), width)).collect::<Vec<_>>()
    };
    floats.flat_map(of).collect()
}

/// The least and the largest of each column as floats.
fn ranges(words: &[u32], width: usize) -> Vec<(f64, f64)> {
    ranges_of(words.par_chunks(width), width)
}

fn ranges_of<'a>(rows: impl ParallelIterator<Item = &'a [u32]>, width: usize) -> Vec<(f64, f64)> {
    let none = || vec![(f64::INFINITY, f64::NEG_INFINITY); width];
    rows.fold(none, |mut ranges, row| {
        for (range, word) in ranges.iter_mut().zip(row) {
            let x = f64::from(f32::from_bits(*word));
            *range = (range.0.min(x), range.1.max(x));
        }
        ranges
    })
    .reduce(none, |a, b| a.iter().zip(b).map(|(a, b)| (a.0.min(b.0), a.1.max(b.1))).collect())
}

/// Words of a row of channels.
pub fn width(infos: &[ChannelInfo]) -> usize {
    infos.iter().map(ChannelInfo::width).sum()
}

/// For each word of a row whether it is a label.
fn label_columns(infos: &[ChannelInfo]) -> Vec<bool> {
    infos.iter().flat_map(|info| std::iter::repeat_n(info.dtype.is_label(), info.width())).collect()
}

impl Channels {
    /// Takes in the caller's channels. Equal values get equal bits.
    pub fn gather(source: &SourceMesh<'_>) -> Self {
        let infos: Vec<_> = source.channels.iter().map(|c| c.info.clone()).collect();
        let width = width(&infos);
        let mut words = vec![0; source.positions.len() * width];
        if width > 0 {
            words.par_chunks_mut(width).enumerate().for_each(|(i, mut row)| {
                for channel in &source.channels {
                    let columns = channel.info.width();
                    let (values, rest) = row.split_at_mut(columns);
                    values.copy_from_slice(&channel.words[i * columns..][..columns]);
                    if !channel.info.dtype.is_label() {
                        values.iter_mut().for_each(|w| *w = (f32::from_bits(*w) + 0.0).to_bits());
                    }
                    row = rest;
                }
            });
        }
        Self { infos, words, scales: Vec::new() }
    }

    /// Adds copies of some rows.
    pub fn copy_rows(&mut self, vertices: &[u32]) {
        let width = self.width();
        vertices
            .iter()
            .for_each(|v| self.words.extend_from_within(*v as usize * width..(*v as usize + 1) * width));
    }

    /// Words of a row.
    pub fn width(&self) -> usize {
        width(&self.infos)
    }

    /// Widths of the floating-point channels.
    pub fn float_widths(&self) -> impl Iterator<Item = usize> {
        self.infos.iter().filter(|info| !info.dtype.is_label()).map(ChannelInfo::width)
    }

    /// Keeps the rows of some vertices, in the order given.
    pub fn keep(&mut self, vertices: &[u32]) {
        let width = self.width();
        if width == 0 {
            return;
        }
        let mut words = vec![0; vertices.len() * width];
        words
            .par_chunks_mut(width)
            .zip(vertices)
            .for_each(|(row, v)| row.copy_from_slice(&self.words[*v as usize * width..][..width]));
        self.words = words;
    }

    /// How the floats of these vertices are scaled where they are all.
    pub fn own_scales(&self) -> Vec<Scale> {
        let ranges = if self.infos.is_empty() { Vec::new() } else { ranges(&self.words, self.width()) };
        let floats = self.columns().filter(|columns| columns.float.is_some());
        floats.flat_map(|columns| Scale::of_channel(&ranges[columns.words]).collect::<Vec<_>>()).collect()
    }

    /// Writes the scaled floats of every vertex to the end of its row of `stride` floats.
    pub fn scale(&self, rows: &mut [f32], stride: usize) {
        let first = stride - self.scales.len();
        if self.scales.is_empty() {
            return;
        }
        let is_label = label_columns(&self.infos);
        rows.par_chunks_mut(stride).zip(self.words.par_chunks(self.width())).for_each(|(row, words)| {
            let floats = words.iter().zip(&is_label).filter(|(_, label)| !**label).map(|(word, _)| word);
            for ((out, word), scale) in row[first..].iter_mut().zip(floats).zip(&self.scales) {
                *out = scale.scaled(*word);
            }
        });
    }

    /// For each source vertex the first one with the same labels; empty when there are none.
    pub fn label_numbers(&self) -> Vec<u32> {
        let is_label = label_columns(&self.infos);
        let labels = is_label.iter().filter(|label| **label).count();
        if labels == 0 {
            return Vec::new();
        }
        let of_row = |row: &[u32]| -> Vec<u32> {
            row.iter().zip(&is_label).filter(|(_, label)| **label).map(|(word, _)| *word).collect()
        };
        let words: Vec<u32> = self.words.par_chunks(self.width()).flat_map_iter(of_row).collect();
        hash::first_equal(&words, labels)
    }

    /// The channels over all identities: source vertices come first, with the words they came with. `rows` are the
    /// attribute rows of all, of `stride` floats; `labels` the source vertex whose labels each has.
    pub fn finish(&self, rows: &[f32], stride: usize, labels: &[u32]) -> Vec<Channel> {
        self.finish_of(rows, stride, labels, self.first())
    }

    /// The same over any vertices; `source` tells which source vertex one is.
    pub fn finish_of(
        &self,
        rows: &[f32],
        stride: usize,
        labels: &[u32],
        source: impl Fn(usize) -> Option<usize> + Sync,
    ) -> Vec<Channel> {
        let finish = |columns: Columns<'_>| {
            let width = columns.words.len();
            let mut words = vec![0; rows.len() / stride * width];
            words.par_chunks_mut(width).enumerate().for_each(|(v, out)| {
                let row = &rows[v * stride..][..stride];
                self.words_of(&columns, source(v), row, labels.get(v), out);
            });
            Channel { info: columns.info.clone(), words: words.into() }
        };
        self.columns().map(finish).collect()
    }

    /// The same as one table: a row for each identity, with the words of all channels.
    pub fn finish_rows(&self, rows: &[f32], stride: usize, labels: &[u32]) -> Vec<u32> {
        let (width, source) = (self.width(), self.first());
        let mut words = vec![0; rows.len() / stride * width];
        if width > 0 {
            words.par_chunks_mut(width).enumerate().for_each(|(v, out)| {
                let row = &rows[v * stride..][..stride];
                for columns in self.columns() {
                    let own = &mut out[columns.words.clone()];
                    self.words_of(&columns, source(v), row, labels.get(v), own);
                }
            });
        }
        words
    }

    /// The source vertex that an identity is: they come first.
    fn first(&self) -> impl Fn(usize) -> Option<usize> + Sync {
        let sources = self.words.len().checked_div(self.width()).unwrap_or(0);
        move |v| (v < sources).then_some(v)
    }

    /// The words that a vertex has of a channel: those of a source vertex, or of the one whose label it has, or else what its
    /// row says.
    fn words_of(
        &self,
        columns: &Columns<'_>,
        source: Option<usize>,
        row: &[f32],
        label: Option<&u32>,
        out: &mut [u32],
    ) {
        let known = source.or_else(|| columns.float.is_none().then(|| label.map(|v| *v as usize)).flatten());
        if let Some(of) = known {
            out.copy_from_slice(&self.words[of * self.width()..][columns.words.clone()]);
        } else if let Some(first) = columns.float {
            let scaled = &row[row.len() - self.scales.len() + first..];
            for ((out, x), scale) in out.iter_mut().zip(scaled).zip(&self.scales[first..]) {
                *out = scale.word(*x);
            }
        }
    }

    /// Where each channel lies in a row.
    fn columns(&self) -> impl Iterator<Item = Columns<'_>> {
        let (mut word, mut float) = (0, 0);
        self.infos.iter().map(move |info| {
            let (words, is_label) = (word..word + info.width(), info.dtype.is_label());
            word = words.end;
            let first = (!is_label).then_some(float);
            float += if is_label { 0 } else { info.width() };
            Columns { info, words, float: first }
        })
    }
}

/// Where a channel lies in a row.
struct Columns<'a> {
    info: &'a ChannelInfo,
    /// Its words.
    words: Range<usize>,
    /// The first of its scales, unless it is a label.
    float: Option<usize>,
}
