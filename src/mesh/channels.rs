//! Named channels between the caller's arrays and the finished mesh: the exact words of the source, and the columns
//! that simplifiers work on. Floats are scaled by the range of their channel, so that weights have no unit. A label
//! is the number of the first source vertex with the same labels, so that a simplified vertex always has the labels
//! of one source vertex.

use rayon::prelude::*;

use super::hash;
use super::source::SourceMesh;
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
    scales: Vec<Scale>,
}

/// How a column is scaled.
#[derive(Clone, Copy, Debug)]
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

/// The least and the largest of each column as floats.
fn ranges(words: &[u32], width: usize) -> Vec<(f64, f64)> {
    let none = || vec![(f64::INFINITY, f64::NEG_INFINITY); width];
    words
        .par_chunks(width)
        .fold(none, |mut ranges, row| {
            for (range, word) in ranges.iter_mut().zip(row) {
                let x = f64::from(f32::from_bits(*word));
                *range = (range.0.min(x), range.1.max(x));
            }
            ranges
        })
        .reduce(none, |a, b| a.iter().zip(b).map(|(a, b)| (a.0.min(b.0), a.1.max(b.1))).collect())
}

fn width(infos: &[ChannelInfo]) -> usize {
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

    /// Keeps the rows of some vertices, in the order given, and finds the range of the floats among them.
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
        let ranges = ranges(&self.words, width);
        self.scales.clear();
        let mut at = 0;
        for info in &self.infos {
            let columns = &ranges[at..at + info.width()];
            at += info.width();
            if !info.dtype.is_label() {
                self.scales.extend(Scale::of_channel(columns));
            }
        }
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
        let sources = self.words.len().checked_div(self.width()).unwrap_or(0);
        self.finish_of(rows, stride, labels, |v| (v < sources).then_some(v))
    }

    /// The same over any vertices; `source` tells which source vertex one is.
    pub fn finish_of(
        &self,
        rows: &[f32],
        stride: usize,
        labels: &[u32],
        source: impl Fn(usize) -> Option<usize> + Sync,
    ) -> Vec<Channel> {
        let (width, count) = (self.width(), rows.len() / stride);
        let first = stride - self.scales.len();
        let (mut word_at, mut float_at) = (0, 0);
        let finish = |info: &ChannelInfo| {
            let columns = info.width();
            let (word, float) = (word_at, float_at);
            word_at += columns;
            let is_label = info.dtype.is_label();
            float_at += if is_label { 0 } else { columns };
            let mut words = vec![0; count * columns];
            words.par_chunks_mut(columns).enumerate().for_each(|(v, out)| {
                let known = source(v).or_else(|| is_label.then(|| labels[v] as usize));
                if let Some(of) = known {
                    out.copy_from_slice(&self.words[of * width + word..][..columns]);
                    return;
                }
                let scaled = &rows[v * stride + first + float..][..columns];
                for ((out, x), scale) in out.iter_mut().zip(scaled).zip(&self.scales[float..]) {
                    *out = scale.word(*x);
                }
            });
            Channel { info: info.clone(), words: words.into() }
        };
        self.infos.iter().map(finish).collect()
    }
}
