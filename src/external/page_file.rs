//! Pages on disk as they are in memory, until a file is made of them.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::spool::read_at;
use crate::error::{Error, Result};
use crate::model::{Dag, Outline, PageRequest, PageSink, PageSource, PageWords, Pages, Workers};

/// Writes pages; of them comes a mesh whose pages stay there.
pub struct PageFileSink {
    path: PathBuf,
    out: BufWriter<File>,
}

impl PageFileSink {
    /// Into a new file.
    pub fn create(path: &Path) -> Result<Self> {
        let file = File::create(path).map_err(io(path))?;
        Ok(Self { path: path.to_path_buf(), out: BufWriter::new(file) })
    }
}

fn io(path: &Path) -> impl Fn(std::io::Error) -> Error + '_ {
    |source| Error::Io { path: path.to_path_buf(), source }
}

impl PageSink for PageFileSink {
    type Output = Dag;

    fn begin(&mut self, _: &Outline) -> Result<()> {
        Ok(())
    }

    fn pages(&mut self, _: &Outline, words: Vec<PageWords>) -> Result<()> {
        let mut pages = words.iter();
        pages.try_for_each(|page| self.out.write_all(bytemuck::cast_slice(page))).map_err(io(&self.path))
    }

    fn finish(mut self, Outline { mesh, dependencies }: Outline) -> Result<Dag> {
        self.out.flush().map_err(io(&self.path))?;
        let file = File::open(&self.path).map_err(io(&self.path))?;
        let table = mesh.pages.table.to_vec();
        let mut starts = vec![0];
        table.iter().for_each(|entry| starts.push(starts[starts.len() - 1] + u64::from(entry.words)));
        let source = PageFile(Arc::new(Opened { path: self.path, file, starts }), dependencies);
        let pages = Pages::stored(table, mesh.layout(), Arc::new(source));
        Ok(Dag { pages: Arc::new(pages), ..mesh })
    }
}

/// The pages, and for each the others with clusters that were made from its groups.
#[derive(Debug)]
struct PageFile(Arc<Opened>, Vec<Vec<u32>>);

#[derive(Debug)]
struct Opened {
    path: PathBuf,
    file: File,
    /// The first word of each page, and the end of the last.
    starts: Vec<u64>,
}

impl Opened {
    fn read(&self, page: usize) -> Result<PageWords> {
        let mut words = vec![0u32; (self.starts[page + 1] - self.starts[page]) as usize];
        let offset = self.starts[page] * size_of::<u32>() as u64;
        read_at(&self.file, bytemuck::cast_slice_mut(&mut words), offset).map_err(io(&self.path))?;
        Ok(words.into())
    }
}

impl PageSource for PageFile {
    fn read(&self, batch: Vec<PageRequest>, workers: &Workers) {
        for PageRequest { page, answer } in batch {
            let opened = Arc::clone(&self.0);
            workers.last(move || answer.send(opened.read(page)));
        }
    }

    fn dependencies(&self, page: usize) -> &[u32] {
        &self.1[page]
    }
}
