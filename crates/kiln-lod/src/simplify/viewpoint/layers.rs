//! What lies behind every pixel: depth-sorted fragments, compact, with the nearest of each pixel apart.
//!
//! The nearest fragments of a view are one flat array, which is all that most questions read. What lies behind them lies in blocks of
//! one pool, farthest first, so that taking the nearest out moves nothing; a block has room for a power of two and comes from the
//! free blocks of its class. A pixel holds as many fragments as faces cover its centre, whatever the number of triangles: about 40 MB for
//! 20 views of 256 x 256.

use super::screen::Fragment;

/// Pixels across a tile, as a shift.
const TILE: u32 = 3;
/// A class of blocks has twice the room of the one before.
const CLASSES: usize = 32;

/// The fragments of a pixel behind the nearest.
#[derive(Clone, Copy, Debug, Default)]
struct Rest {
    first: u32,
    count: u32,
    /// Class of its block plus 1; 0 for none.
    class: u32,
}

/// A rectangle of tiles, the last ones in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tiles {
    pub(super) x0: u32,
    pub(super) y0: u32,
    pub(super) x1: u32,
    pub(super) y1: u32,
}

/// All fragments of one view.
pub(super) struct Layers {
    /// `[size * size]`.
    pub(super) front: Vec<Fragment>,
    rest: Vec<Rest>,
    pool: Vec<Fragment>,
    free: [Vec<u32>; CLASSES],
    /// `[tiles * tiles]`: when a fragment changed last.
    stamps: Vec<u32>,
    /// `[tiles * tiles]`: the farthest of the nearest fragments.
    far: Vec<i32>,
    tiles: u32,
    size: u32,
    /// Pixels that went from one region to another since the list was emptied: before, after, how many.
    pub(super) moves: Vec<(u32, u32, u32)>,
}

impl Layers {
    pub(super) fn new(size: u32) -> Layers {
        let (pixels, tiles) = (size as usize * size as usize, size.div_ceil(1 << TILE));
        Layers {
            front: vec![Fragment::BACKGROUND; pixels],
            rest: vec![Rest::default(); pixels],
            pool: Vec::new(),
            free: [const { Vec::new() }; CLASSES],
            stamps: vec![0; (tiles * tiles) as usize],
            far: vec![i32::MAX; (tiles * tiles) as usize],
            tiles,
            size,
            moves: Vec::new(),
        }
    }

    /// The fragments behind the nearest, nearest first.
    #[inline]
    pub(super) fn behind(&self, pixel: usize) -> impl Iterator<Item = &Fragment> {
        let rest = self.rest[pixel];
        self.pool[rest.first as usize..(rest.first + rest.count) as usize].iter().rev()
    }

    /// Notes what a pixel showed and shows.
    #[inline]
    fn moved(&mut self, before: u32, after: u32) {
        if before == after {
            return;
        }
        match self.moves.last_mut() {
            Some(last) if (last.0, last.1) == (before, after) => last.2 += 1,
            _ => self.moves.push((before, after, 1)),
        }
    }

    /// Adds a fragment.
    #[inline]
    pub(super) fn insert(&mut self, pixel: usize, fragment: Fragment) {
        let front = self.front[pixel];
        if fragment.hides(&front) {
            self.front[pixel] = fragment;
            if front != Fragment::BACKGROUND {
                self.push(pixel, front);
            }
            self.moved(front.region, fragment.region);
            return;
        }
        let rest = self.push(pixel, fragment);
        let block = &mut self.pool[rest.first as usize..(rest.first + rest.count) as usize];
        let mut at = block.len() - 1;
        while at > 0 && !block[at].hides(&block[at - 1]) {
            block.swap(at, at - 1);
            at -= 1;
        }
    }

    /// Appends a fragment to the rest of a pixel.
    #[inline]
    fn push(&mut self, pixel: usize, fragment: Fragment) -> Rest {
        let mut rest = self.rest[pixel];
        if rest.class == 0 || rest.count == 1 << (rest.class - 1) {
            rest = self.grown(rest);
        }
        self.pool[(rest.first + rest.count) as usize] = fragment;
        rest.count += 1;
        self.rest[pixel] = rest;
        rest
    }

    /// The same rest in a block of the next class.
    #[cold]
    fn grown(&mut self, rest: Rest) -> Rest {
        let room = 1_usize << rest.class;
        let first = self.free[rest.class as usize].pop().unwrap_or_else(|| {
            let first = self.pool.len();
            self.pool.resize(first + room, Fragment::BACKGROUND);
            first as u32
        });
        let old = rest.first as usize;
        self.pool.copy_within(old..old + rest.count as usize, first as usize);
        if rest.class > 0 {
            self.free[rest.class as usize - 1].push(rest.first);
        }
        Rest { first, count: rest.count, class: rest.class + 1 }
    }

    /// Takes the fragment of `face` out.
    #[inline]
    pub(super) fn remove(&mut self, pixel: usize, face: u32) {
        let (front, rest) = (self.front[pixel], &mut self.rest[pixel]);
        let block = &mut self.pool[rest.first as usize..(rest.first + rest.count) as usize];
        if front.face == face {
            let next = block.last().copied().unwrap_or(Fragment::BACKGROUND);
            rest.count -= u32::from(!block.is_empty());
            self.front[pixel] = next;
            self.moved(front.region, next.region);
            return;
        }
        if let Some(at) = block.iter().rposition(|fragment| fragment.face == face) {
            block.copy_within(at + 1.., at);
            rest.count -= 1;
        }
    }

    /// Notes that fragments of the pixels `from..to` of one row change at time `now`.
    #[inline]
    pub(super) fn stamp(&mut self, from: usize, to: usize, now: u32) {
        let size = self.size as usize;
        let (row, first) = ((from / size) >> TILE, from % size);
        let last = first + (to - from) - 1;
        let start = row * self.tiles as usize;
        self.stamps[start + (first >> TILE)..=start + (last >> TILE)].fill(now);
    }

    /// Whether a fragment in those tiles changed after `time`.
    #[inline]
    pub(super) fn changed(&self, tiles: &Tiles, time: u32) -> bool {
        (tiles.y0..=tiles.y1).any(|y| {
            let row = (y * self.tiles) as usize;
            self.stamps[row + tiles.x0 as usize..=row + tiles.x1 as usize].iter().any(|stamp| *stamp > time)
        })
    }

    /// Whether all that lies in those tiles at `depth` or behind it is hidden.
    #[inline]
    pub(super) fn hide(&self, tiles: &Tiles, depth: i32) -> bool {
        (tiles.y0..=tiles.y1).all(|y| {
            let row = (y * self.tiles) as usize;
            self.far[row + tiles.x0 as usize..=row + tiles.x1 as usize].iter().all(|far| *far < depth)
        })
    }

    /// Brings [`Layers::hide`] up to date in the tiles that were stamped at `now`.
    pub(super) fn settle(&mut self, tiles: &Tiles, now: u32) {
        for (y, x) in (tiles.y0..=tiles.y1).flat_map(|y| (tiles.x0..=tiles.x1).map(move |x| (y, x))) {
            let tile = (y * self.tiles + x) as usize;
            if self.stamps[tile] != now {
                continue;
            }
            let end = |t: u32| ((t + 1) << TILE).min(self.size);
            let mut far = i32::MIN;
            for row in y << TILE..end(y) {
                let start = (row * self.size) as usize;
                let pixels = &self.front[start + (x << TILE) as usize..start + end(x) as usize];
                far = pixels.iter().fold(far, |far, fragment| far.max(fragment.depth));
            }
            self.far[tile] = far;
        }
    }

    /// Every tile.
    pub(super) fn all(&self) -> Tiles {
        Tiles { x0: 0, y0: 0, x1: self.tiles - 1, y1: self.tiles - 1 }
    }
}

/// The tiles over pixels whose centres lie in the box of points `low..=high` (1/256 pixel) of a screen; `None` if there are none.
#[inline]
pub(super) fn tiles_of(low: [i32; 2], high: [i32; 2], size: u32) -> Option<Tiles> {
    // The first centre at or behind `low`, the last at or before `high`.
    let first = |k: usize| (low[k].saturating_add(127) >> 8).max(0);
    let last = |k: usize| (high[k].saturating_sub(128) >> 8).min(size as i32 - 1);
    let (x0, y0, x1, y1) = (first(0), first(1), last(0), last(1));
    (x0 <= x1 && y0 <= y1).then(|| {
        let [x0, y0, x1, y1] = [x0, y0, x1, y1].map(|v| v as u32 >> TILE);
        Tiles { x0, y0, x1, y1 }
    })
}
