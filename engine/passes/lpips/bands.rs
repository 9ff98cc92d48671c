//! Division of a network into bands of rows. It determines which rows of each layer's map a band computes, and how many rows a
//! map keeps. No row is computed twice, and a map's memory does not grow with the picture's height.

use super::network::{Layer, Network};
use std::ops::Range;

/// Number of pictures that pass through the network side by side.
pub(super) const PICTURES: u32 = 2;
/// Channels of a texel.
pub(super) const CHANNELS: u32 = 4;
const TEXEL_BYTES: u64 = 16;

/// A map of features (feature_map.glsl): the input, or the output of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Map {
    /// Number of blocks of four channels.
    pub blocks: u32,
    pub width: u32,
    pub height: u32,
    /// Number of rows that are kept.
    pub slots: u32,
    /// Number of zero columns on each side, for the padding of the layer that reads the map.
    pub margin: u32,
}

impl Map {
    /// Number of columns from one row to the next.
    pub fn pitch(&self) -> u32 {
        self.width + 2 * self.margin
    }

    pub fn bytes(&self) -> u64 {
        let rows = u64::from(self.slots) + 1;
        u64::from(PICTURES) * u64::from(self.blocks) * rows * u64::from(self.pitch()) * TEXEL_BYTES
    }
}

/// The maps, and the rows that each band computes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Bands {
    /// Map of the input, then of each layer's output.
    pub maps: Vec<Map>,
    /// New rows per band and map.
    pub rows: Vec<Vec<Range<u32>>>,
}

impl Bands {
    /// Divides a picture into bands of `band` rows.
    pub fn new(network: Network, (width, height): (u32, u32), band: u32) -> Self {
        let layers = network.layers();
        let mut maps = vec![Map { blocks: 1, width, height, slots: 0, margin: layers[0].padding }];
        for (layer, next) in layers.iter().zip(layers.iter().skip(1).map(Some).chain([None])) {
            let input = maps[maps.len() - 1];
            maps.push(Map {
                blocks: layer.outputs / CHANNELS,
                width: layer.outputs_of(input.width),
                height: layer.outputs_of(input.height),
                slots: 0,
                margin: next.map_or(0, |next| next.padding),
            });
        }
        let mut rows: Vec<Vec<Range<u32>>> = Vec::new();
        let mut done = vec![0; maps.len()];
        while done[0] < height {
            let mut before = done.clone();
            done[0] = (done[0] + band).min(height);
            for (i, layer) in layers.iter().enumerate() {
                done[i + 1] = layer.outputs_of_first(done[i], maps[i].height).min(maps[i + 1].height);
                let kept = done[i] - first_row_read(layer, before[i + 1]).min(before[i]);
                maps[i].slots = maps[i].slots.max(kept);
            }
            let last = maps.len() - 1;
            maps[last].slots = maps[last].slots.max(done[last] - before[last]);
            rows.push(before.drain(..).zip(&done).map(|(from, &to)| from..to).collect());
        }
        Self { maps, rows }
    }

    /// Bytes of the largest map.
    pub fn largest(&self) -> u64 {
        self.maps.iter().map(Map::bytes).max().unwrap_or(0)
    }

    /// Maximum number of new rows of a map in a band.
    pub fn max_rows(&self, map: usize) -> u32 {
        self.rows.iter().map(|band| band[map].len() as u32).max().unwrap_or(0)
    }

    /// Maximum number of workgroups along an axis of a grid: columns and rows, or blocks.
    pub fn max_grid(&self, workgroup: u32) -> u32 {
        let grid = |(i, map): (usize, &Map)| {
            let pixels = u64::from(map.width) * u64::from(self.max_rows(i));
            pixels.div_ceil(workgroup.into()).max(map.blocks.into())
        };
        self.maps.iter().enumerate().map(grid).max().map_or(0, |max| max.try_into().unwrap_or(u32::MAX))
    }

    /// Number of multiplications in the largest dispatch.
    pub fn max_work(&self, network: Network) -> u64 {
        let work = |(i, layer): (usize, &Layer)| {
            let outputs = u64::from(self.max_rows(i + 1)) * u64::from(self.maps[i + 1].width);
            let window = u64::from(layer.size * layer.size) * u64::from(layer.inputs);
            u64::from(PICTURES) * outputs * u64::from(layer.outputs) * window
        };
        network.layers().iter().enumerate().map(work).max().unwrap_or(0)
    }
}

/// First input row that an output row of a layer reads.
fn first_row_read(layer: &Layer, row: u32) -> u32 {
    (row * layer.stride).saturating_sub(layer.padding)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For any band, each row is computed once, in order, and every row that a window reads is still kept.
    #[test]
    fn every_row_is_computed_once_from_rows_that_are_there() {
        for network in Network::ALL {
            for (height, band) in [(31, 1), (64, 64), (97, 7), (97, 64), (200, 16), (131, 200)] {
                let bands = Bands::new(network, (80, height), band);
                let mut done = vec![0; bands.maps.len()];
                for rows in &bands.rows {
                    for (i, range) in rows.iter().enumerate() {
                        assert_eq!(range.start, done[i]);
                        done[i] = range.end;
                        let Some(before) = i.checked_sub(1).filter(|_| !range.is_empty()) else { continue };
                        let (layer, input) = (&network.layers()[before], &bands.maps[before]);
                        let last = range.end - 1;
                        let end = (last * layer.stride + layer.size).saturating_sub(layer.padding);
                        assert!(
                            end.min(input.height) <= done[before],
                            "{network:?} {height} {band}: row {last}"
                        );
                        let oldest = done[before].saturating_sub(input.slots);
                        assert!(first_row_read(layer, range.start) >= oldest, "{network:?} {height} {band}");
                    }
                }
                let whole: Vec<u32> = bands.maps.iter().map(|map| map.height).collect();
                assert_eq!(done, whole, "{network:?} {height} {band}");
            }
        }
    }

    #[test]
    fn memory_does_not_grow_with_the_height() {
        let bytes = |height| -> u64 {
            Bands::new(Network::Vgg16, (1600, height), 16).maps.iter().map(Map::bytes).sum()
        };
        assert_eq!(bytes(1200), bytes(12_000));
        let whole = Bands::new(Network::Vgg16, (1600, 1200), 1200);
        assert!(whole.largest() > 900 << 20 && bytes(1200) < 128 << 20, "{}", bytes(1200) >> 20);
    }
}
