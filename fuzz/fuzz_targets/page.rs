//! Any bytes as a page: the first says which page of which mesh they stand for, the others go to the decoder.

#![no_main]

use std::cell::RefCell;
use std::sync::{Arc, LazyLock};

use libfuzzer_sys::fuzz_target;
use nanite_fuzz::{damage, meshes, one_thread};
use nanite_rs::format::encode::contexts;
use nanite_rs::format::page::Context;
use nanite_rs::format::page_decode::Decoder;
use nanite_rs::format::validate;
use nanite_rs::model::Dag;

type Page = (&'static Dag, usize, Context<'static>);

/// All pages.
fn pages() -> Vec<Page> {
    let of = |dag: Dag| -> Vec<Page> {
        let dag: &'static Dag = Box::leak(Box::new(dag));
        contexts(dag).into_iter().enumerate().map(|(p, context)| (dag, p, context)).collect()
    };
    meshes().into_iter().flat_map(of).collect()
}

/// For as long as the process lives.
static PAGES: LazyLock<Vec<Page>> = LazyLock::new(pages);

thread_local! {
    // As in a reader, one for page after page, whatever the last one held.
    static DECODER: RefCell<Decoder> = RefCell::new(Decoder::new().unwrap());
}

fn decode((dag, p, context): &Page, bytes: &[u8]) {
    let entry = dag.pages.table[*p];
    let mut words = vec![0; entry.words as usize];
    let read = DECODER
        .with_borrow_mut(|decoder| decoder.decode(context, bytes, entry.clusters as usize, &mut words));
    if read.is_ok() {
        let mut dag = (*dag).clone();
        Arc::make_mut(&mut dag.pages).set(*p, Some(words.into()));
        if validate::structure(&dag).is_ok() {
            damage::exercise(&dag);
            damage::draw(dag);
        }
    }
}

fuzz_target!(init: one_thread(), |bytes: &[u8]| {
    if let Some((which, bytes)) = bytes.split_first() {
        decode(&PAGES[usize::from(*which) % PAGES.len()], bytes);
    }
});
