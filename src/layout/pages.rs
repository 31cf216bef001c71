//! Which page holds which group.

use crate::limits::{PAGE_MAX_BYTES, PAGE_MAX_CLUSTERS, ROOT_PAGE_MAX_BYTES};
use crate::model::{ClusterAddress, PageEntry};

/// Open pages of a level. Each further open page saves some 3 % of the pages, and views need no more of them than
/// before. With four, the last groups of a page are no longer near the others
/// (`benchmarks/results/2026-11-22-format.md`).
const OPEN_PAGES: usize = 2;

/// What a group adds to a page.
#[derive(Clone, Copy, Debug)]
pub struct GroupSize {
    /// Its level.
    pub level: u32,
    /// Nothing coarser was made from it.
    pub root: bool,
    /// Number of its clusters.
    pub clusters: u32,
    /// Words of their records and streams.
    pub words: u32,
    /// Triangles of the source among theirs.
    pub faces: u32,
}

/// Groups in pages.
#[derive(Clone, Debug, Default)]
pub struct Paging {
    /// The pages.
    pub table: Vec<PageEntry>,
    /// Numbers of groups by page, and by place in it.
    pub order: Vec<u32>,
    /// For each in this order the address of its first member.
    pub first: Vec<ClusterAddress>,
}

/// A page that is being filled.
#[derive(Default)]
struct Filling {
    /// Numbers of its groups, and the slot of the first member of each.
    groups: Vec<(u32, u32)>,
    level: u32,
    words: u32,
    clusters: u32,
    faces: u32,
}

impl Filling {
    fn has_room(&self, group: &GroupSize, bytes: usize) -> bool {
        size_of::<u32>() * (self.words + group.words) as usize <= bytes
            && (self.clusters + group.clusters) as usize <= PAGE_MAX_CLUSTERS
    }
}

/// Packs whole groups into pages, in this order, coarsest level first. Roots come first. The last root page is
/// filled up with the next levels, so that little memory holds something to draw. Each further page has one level.
pub fn paginate(order: &[u32], size: impl Fn(u32) -> GroupSize) -> Paging {
    let mut pages = Vec::<Filling>::new();
    // The first page that is still open, and what one may hold.
    let (mut open, mut of_roots) = (0, false);
    for number in order {
        let group = size(*number);
        let most = if of_roots { ROOT_PAGE_MAX_BYTES } else { PAGE_MAX_BYTES };
        let fits = |page: &Filling| (of_roots || page.level == group.level) && page.has_room(&group, most);
        let fullest = (open..pages.len()).filter(|p| fits(&pages[*p])).max_by_key(|p| pages[*p].words);
        let page = fullest.unwrap_or_else(|| {
            let only = of_roots || group.root || pages.last().is_none_or(|last| last.level != group.level);
            open = if only { pages.len() } else { open.max((pages.len() + 1).saturating_sub(OPEN_PAGES)) };
            of_roots = group.root;
            pages.push(Filling { level: group.level, ..Filling::default() });
            pages.len() - 1
        });
        let page = &mut pages[page];
        page.groups.push((*number, page.clusters));
        page.words += group.words;
        page.clusters += group.clusters;
        page.faces += group.faces;
    }
    let mut out = Paging::default();
    for (number, page) in pages.iter().enumerate() {
        let last = out.table.last().copied().unwrap_or_default();
        out.table.push(last.next(page.words, page.clusters, page.level, page.faces));
        out.order.extend(page.groups.iter().map(|group| group.0));
        out.first.extend(page.groups.iter().map(|group| ClusterAddress::new(number, group.1 as usize)));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(level: u32, kib: u32) -> GroupSize {
        GroupSize { level, root: level == 3, clusters: 2, words: kib * 256, faces: 1 }
    }

    fn pages(sizes: &[GroupSize]) -> Vec<Vec<u32>> {
        let order: Vec<u32> = (0..sizes.len() as u32).collect();
        let Paging { table, order, first } = paginate(&order, |g| sizes[g as usize]);
        let mut slots = vec![0; table.len()];
        let mut pages = vec![Vec::new(); table.len()];
        for (group, first) in order.iter().zip(first) {
            assert_eq!(first.slot(), slots[first.page()], "members follow each other");
            assert!(pages[first.page() + 1..].iter().all(Vec::is_empty), "groups follow pages");
            slots[first.page()] += sizes[*group as usize].clusters as usize;
            pages[first.page()].push(*group);
        }
        for (page, entry) in pages.iter().zip(&table) {
            let sum = |of: fn(&GroupSize) -> u32| page.iter().map(|g| of(&sizes[*g as usize])).sum::<u32>();
            assert_eq!(
                [entry.words, entry.clusters, entry.faces],
                [sum(|g| g.words), sum(|g| g.clusters), sum(|g| g.faces)]
            );
        }
        pages
    }

    #[test]
    fn what_does_not_fit_the_last_page_may_fit_the_one_before() {
        let level = |kib: &[u32]| kib.iter().map(|kib| group(0, *kib)).collect::<Vec<_>>();
        assert_eq!(pages(&level(&[100, 60, 20, 40, 60])), [vec![0, 2], vec![1, 3], vec![4]]);
        // Of two with room the fuller one; and of three the first is closed.
        assert_eq!(pages(&level(&[100, 60, 20])), [vec![0, 2], vec![1]]);
        assert_eq!(pages(&level(&[100, 120, 110, 20])), [vec![0], vec![1], vec![2], vec![3]]);
    }

    #[test]
    fn roots_come_first_with_what_is_next_and_further_pages_have_one_level() {
        let sizes = [group(3, 20), group(2, 10), group(2, 60), group(1, 2), group(1, 60), group(0, 2)];
        assert_eq!(pages(&sizes), [vec![0, 1], vec![2], vec![3, 4], vec![5]]);
        let sizes = [group(3, 20), group(3, 20), group(2, 10), group(2, 4)];
        assert_eq!(pages(&sizes), [vec![0], vec![1, 2], vec![3]]);
    }
}
