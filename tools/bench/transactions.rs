//! Memory transactions: memory segments that a subgroup touches at once where its lanes access scattered addresses.
//!
//! They are counted on the host from the workload's own data: the keys of a sort, the lists of a frame's tiles
//! ([`Renderer::tile_lists`](ashsplat::Renderer::tile_lists)). Counted are the stores of sort_downsweep, and the gathers of count,
//! blend and blend_backward. In all other kernels, lanes access neighbouring addresses: bytes over the segment's size.

use super::schema::{Run, Segments, Transactions};
use ashsplat::TileLists;
use ashsplat::frame::tuning::Tuning;
use ashsplat::frame::{region_height, tile_bits};
use ashsplat::kernels::constants as c;
use std::collections::BTreeMap;

/// Counted subgroup sizes: those of GPUs.
const LANES: [u32; 3] = [16, 32, 64];
/// Approximate number of tile entries to blend on the host: only every nth tile is blended.
const SAMPLED_ENTRIES: usize = 1 << 18;
/// Bytes of a Gaussian's record, and the planes that blending reads.
const RECORD: u64 = 16 * c::SPLAT_PLANES as u64;
const PLANES: [u32; 3] = [c::SPLAT_MEAN2D_EXTENT, c::SPLAT_CONIC_OPACITY, c::SPLAT_COLOR_INVERSE_DEPTH];
/// Bytes of a Gaussian's list of tiles.
const TILE_LIST: u64 = 8;

/// Transactions by stage and kernel.
pub type Counted = BTreeMap<(&'static str, &'static str), Transactions>;

/// Enters the transactions into a run.
pub fn enter(run: &mut Run, counted: &Counted) {
    for kernel in &mut run.kernels {
        let place = (kernel.scope.as_str(), kernel.kernel.as_str());
        kernel.transactions = counted.iter().find(|(at, _)| **at == place).map(|(_, found)| found.clone());
    }
}

/// Counts a sort alone, whose workgroups have `block` pairs.
pub fn of_sort(keys: &[u32], block: u32) -> Counted {
    BTreeMap::from([(("sort", "sort/sort_downsweep"), stores_of_sort(keys.to_vec(), u32::BITS, block))])
}

/// Counts a frame, or a training step if `backward`.
pub fn of_frame(lists: &TileLists, size: (u32, u32), block: u32, backward: bool) -> Counted {
    let order = by_depth(lists);
    let mut gather = Counting::default();
    gather.access(order.iter().map(|&visible| u64::from(visible) * TILE_LIST), TILE_LIST);
    let depths = lists.splats.iter().map(|splat| splat.depth.to_bits()).collect();
    let instances =
        stores_of_sort(unsorted_tiles(lists, &order), tile_bits(lists.ranges.len() as u32), block);
    let [forward, behind] = fetches(lists, size);
    let mut counted = BTreeMap::from([
        (("depth sort", "sort/sort_downsweep"), stores_of_sort(depths, u32::BITS, block)),
        (("tile sort", "sort/sort_downsweep"), instances),
        (("count", "forward/count"), gather.end(lists.splats.len() as u64 * TILE_LIST)),
        (("blend", "forward/blend"), forward),
    ]);
    if backward {
        counted.insert(("blend backward", "backward/blend_backward"), behind);
    }
    counted
}

/// Segments touched so far.
#[derive(Default)]
struct Counting {
    bytes: u64,
    /// By subgroup size; segments of 32, 64 and 128 bytes.
    segments: [[u64; 3]; LANES.len()],
    found: Vec<u64>,
}

impl Counting {
    /// Counts one access of every invocation in turn, at these addresses.
    fn access(&mut self, addresses: impl Iterator<Item = u64> + Clone, bytes: u64) {
        self.bytes += bytes * addresses.clone().count() as u64;
        for at in 0..LANES.len() {
            self.access_of(at, addresses.clone());
        }
    }

    /// Same as [`Counting::access`], but for one subgroup size and without the bytes.
    fn access_of(&mut self, at: usize, mut addresses: impl Iterator<Item = u64>) {
        loop {
            self.found.clear();
            self.found.extend(addresses.by_ref().take(LANES[at] as usize).map(|address| address / 32));
            if self.found.is_empty() {
                return;
            }
            self.found.sort_unstable();
            for (size, sum) in self.segments[at].iter_mut().enumerate() {
                let runs = self.found.chunk_by(|a, b| a >> size == b >> size);
                *sum += runs.count() as u64;
            }
        }
    }

    fn end(self, array_bytes: u64) -> Transactions {
        let segments = LANES.into_iter().zip(self.segments);
        let by_lanes =
            segments.map(|(lanes, [of_32, of_64, of_128])| Segments { lanes, of_32, of_64, of_128 });
        Transactions { bytes: self.bytes, array_bytes, by_lanes: by_lanes.collect() }
    }
}

/// Counts the stores of all passes of a stable radix sort. A workgroup orders its pairs by digit, and neighbouring lanes store
/// neighbouring pairs of that order.
fn stores_of_sort(mut keys: Vec<u32>, key_bits: u32, block: u32) -> Transactions {
    let passes = key_bits.div_ceil(c::SORT_BINS.ilog2());
    let digit_bits = key_bits.div_ceil(passes);
    let mut counting = Counting::default();
    let mut sorted = vec![0; keys.len()];
    for pass in 0..passes {
        let digit = |key: u32| (key >> (pass * digit_bits)) as usize & ((1 << digit_bits) - 1);
        let mut next = vec![0u64; (1 << digit_bits) + 1];
        keys.iter().for_each(|&key| next[digit(key) + 1] += 1);
        (1..next.len()).for_each(|k| next[k] += next[k - 1]);
        let mut target = |key: u32| {
            let place = &mut next[digit(key)];
            *place += 1;
            *place - 1
        };
        let targets: Vec<u64> = keys.iter().map(|&key| target(key)).collect();
        let mut stores = targets.clone();
        // Within a block, lower digits are stored first.
        stores.chunks_mut(block as usize).for_each(<[u64]>::sort_unstable);
        // Keys and values have separate buffers.
        for _ in 0..2 {
            counting.access(stores.iter().map(|target| target * 4), 4);
        }
        keys.iter().zip(&targets).for_each(|(&key, &target)| sorted[target as usize] = key);
        std::mem::swap(&mut keys, &mut sorted);
    }
    counting.end(keys.len() as u64 * 8)
}

/// Visible Gaussians from near to far.
fn by_depth(lists: &TileLists) -> Vec<u32> {
    let mut order: Vec<u32> = (0..lists.splats.len() as u32).collect();
    order.sort_by_key(|&visible| lists.splats[visible as usize].depth.to_bits());
    order
}

/// Tiles of all instances before sorting: by depth, and row by row for each Gaussian.
fn unsorted_tiles(lists: &TileLists, order: &[u32]) -> Vec<u32> {
    let mut first = vec![0usize; order.len() + 1];
    lists.entries.iter().for_each(|&visible| first[visible as usize + 1] += 1);
    (1..first.len()).for_each(|k| first[k] += first[k - 1]);
    let mut next = first.clone();
    let mut tiles = vec![0u32; lists.entries.len()];
    for (tile, &[begin, end]) in lists.ranges.iter().enumerate() {
        for &visible in &lists.entries[begin as usize..end as usize] {
            let place = &mut next[visible as usize];
            tiles[*place] = tile as u32;
            *place += 1;
        }
    }
    let own = |&visible: &u32| tiles[first[visible as usize]..first[visible as usize + 1]].iter().copied();
    order.iter().flat_map(own).collect()
}

/// Counts the fetches of blending and its backward pass. Each region of a tile fetches its Gaussians, a subgroup at a time,
/// until its pixels have stopped. Only some tiles' pixels are blended here.
fn fetches(lists: &TileLists, size: (u32, u32)) -> [Transactions; 2] {
    let every = lists.entries.len().div_ceil(SAMPLED_ENTRIES).max(1);
    let filled = lists.ranges.iter().enumerate().filter(|(_, [begin, end])| begin < end);
    let mut counting = [Counting::default(), Counting::default()];
    let mut sampled = 0;
    for (tile, &[begin, end]) in filled.step_by(every) {
        let entries = &lists.entries[begin as usize..end as usize];
        let ends = pixel_ends(lists, tile as u32, entries, size);
        sampled += entries.len();
        for (counting, ends) in counting.iter_mut().zip(ends) {
            fetch(counting, entries, &ends);
        }
    }
    let scale = lists.entries.len() as f64 / sampled.max(1) as f64;
    let scaled = |count: &mut u64| *count = (*count as f64 * scale) as u64;
    counting.map(|mut counting| {
        scaled(&mut counting.bytes);
        counting.segments.iter_mut().flatten().for_each(scaled);
        counting.end(lists.splats.len() as u64 * RECORD)
    })
}

/// Adds the fetches of a tile's regions. `ends`: number of entries that each pixel needs.
fn fetch(counting: &mut Counting, entries: &[u32], ends: &[u32]) {
    for (at, lanes) in LANES.into_iter().enumerate() {
        let rows = region_height(&Tuning::GPU, lanes) as usize;
        let tile = c::TILE_SIZE as usize;
        for region in 0..tile / 8 * (tile / rows) {
            let inside = |&pixel: &usize| pixel % tile / 8 == region % 2 && pixel / tile / rows == region / 2;
            let last = (0..tile * tile).filter(inside).map(|pixel| ends[pixel]).max().unwrap_or(0);
            let batches = last.div_ceil(lanes) * lanes;
            let fetched = &entries[..entries.len().min(batches as usize)];
            for plane in PLANES {
                let address = |&visible: &u32| u64::from(visible) * RECORD + u64::from(plane) * 16;
                counting.access_of(at, fetched.iter().map(address));
                // Bytes are counted once, for 32 lanes.
                counting.bytes += if lanes == 32 { 16 * fetched.len() as u64 } else { 0 };
            }
        }
    }
}

/// For each pixel of a tile: the number of entries until it stops, and until the last one that it blends.
fn pixel_ends(lists: &TileLists, tile: u32, entries: &[u32], (width, height): (u32, u32)) -> [Vec<u32>; 2] {
    let corner = [tile % lists.tiles_per_row, tile / lists.tiles_per_row].map(|k| k * c::TILE_SIZE);
    let mut ends = [Vec::new(), Vec::new()];
    for pixel in 0..c::TILE_SIZE * c::TILE_SIZE {
        let [x, y] = [corner[0] + pixel % c::TILE_SIZE, corner[1] + pixel / c::TILE_SIZE];
        let mut transmittance = if x < width && y < height { 1.0 } else { 0.0 };
        let [mut looked, mut blended] = [0, 0];
        for (place, &visible) in (1..).zip(entries) {
            if transmittance == 0.0 {
                break;
            }
            looked = place;
            let splat = &lists.splats[visible as usize];
            let [dx, dy] = [splat.mean2d_px[0] - x as f32, splat.mean2d_px[1] - y as f32];
            let [xx, xy, yy] = splat.conic;
            let power = -0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy;
            let alpha = (splat.opacity * power.exp()).min(c::ALPHA_MAX);
            if power <= 0.0 && alpha >= c::ALPHA_MIN {
                let next = transmittance * (1.0 - alpha);
                let goes_on = next >= c::TRANSMITTANCE_MIN;
                (transmittance, blended) = if goes_on { (next, place) } else { (0.0, blended) };
            }
        }
        ends[0].push(looked);
        ends[1].push(blended);
    }
    ends
}

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::ProjectedSplat;

    fn of(transactions: &Transactions, lanes: u32) -> [u64; 3] {
        let found = transactions.by_lanes.iter().find(|of| of.lanes == lanes).expect("a size");
        [found.of_32, found.of_64, found.of_128]
    }

    /// By hand: neighbours fill segments; a stride of 128 bytes takes one segment of any size per lane.
    #[test]
    fn segments_are_those_that_a_subgroup_touches() {
        let mut counting = Counting::default();
        counting.access((0..64).map(|k| 4 * k), 4);
        let streamed = counting.end(256);
        assert_eq!(streamed.bytes, 256);
        assert_eq!(
            [of(&streamed, 16), of(&streamed, 32), of(&streamed, 64)],
            [[8, 4, 4], [8, 4, 2], [8, 4, 2]]
        );
        let mut counting = Counting::default();
        counting.access((0..64).rev().map(|k| 128 * k), 4);
        assert_eq!(of(&counting.end(0), 32), [64; 3]);
    }

    /// Equal keys are stored side by side. With two alternating digits, each block stores two runs.
    #[test]
    fn stores_of_a_sort_follow_its_keys() {
        let equal = stores_of_sort(vec![7; 64], 8, 64);
        assert_eq!((equal.bytes, equal.array_bytes, of(&equal, 32)), (512, 512, [16, 8, 4]));
        let alternating = |block| stores_of_sort((0..64).map(|k| k % 2).collect(), 8, block);
        assert_eq!([32, 64].map(|lanes| of(&alternating(64), lanes)), [[16, 8, 4]; 2]);
        // A block of 32 has 16 of each digit: two runs of 64 bytes, 128 apart.
        assert_eq!([32, 64].map(|lanes| of(&alternating(32), lanes)), [[16, 8, 8], [16, 8, 4]]);
        // 32 bits take four passes, 9 bits two.
        assert_eq!(stores_of_sort(vec![7; 64], 32, 64).bytes, 4 * 512);
        assert_eq!(stores_of_sort(vec![7; 64], 9, 64).bytes, 2 * 512);
    }

    /// One tile with 40 Gaussians: all far too faint, or opaque, so that every pixel soon stops.
    #[test]
    fn fetches_end_where_pixels_stop() {
        let lists = |opacity, conic| TileLists {
            tiles_per_row: 1,
            ranges: vec![[0, 40]],
            entries: (0..40).rev().collect(),
            splats: vec![ProjectedSplat { opacity, conic, depth: 1.0, ..ProjectedSplat::default() }; 40],
        };
        let faint = fetches(&lists(0.001, [0.0; 3]), (16, 16));
        // 40 records of 64 bytes by 4 regions and 3 planes.
        assert_eq!((faint[0].bytes, of(&faint[0], 32)), (4 * 3 * 40 * 16, [480, 480, 4 * 3 * 20]));
        assert_eq!(of(&faint[1], 32), [0; 3], "none is blended");
        // At 0.99 the third Gaussian stops every pixel: one batch for each of 8, 4 and 4 regions.
        let opaque = fetches(&lists(0.99, [0.0; 3]), (16, 16));
        assert_eq!(opaque.each_ref().map(|t| of(t, 16)), [[8 * 3 * 16, 8 * 3 * 16, 8 * 3 * 8]; 2]);
        assert_eq!(of(&opaque[0], 32), [4 * 3 * 32, 4 * 3 * 32, 4 * 3 * 16]);
        // Nothing is blended outside the picture.
        assert_eq!(of(&fetches(&lists(0.99, [0.0; 3]), (8, 8))[0], 32), [3 * 32, 3 * 32, 3 * 16]);
    }

    /// Two Gaussians in two tiles each; the nearer one is second in the scene.
    #[test]
    fn instances_are_listed_in_the_order_of_depth() {
        let splat = |depth| ProjectedSplat { depth, ..ProjectedSplat::default() };
        let lists = TileLists {
            tiles_per_row: 3,
            ranges: vec![[0, 1], [1, 3], [3, 4]],
            entries: vec![1, 1, 0, 0],
            splats: vec![splat(2.0), splat(1.0)],
        };
        let order = by_depth(&lists);
        assert_eq!(order, [1, 0]);
        assert_eq!(unsorted_tiles(&lists, &order), [0, 1, 1, 2]);
    }
}
