//! Codebooks: 256 values for many numbers, and a palette of vectors for many vectors, both by k-means (Lloyd's algorithm).
//!
//! No random numbers, and sums in a fixed order, so that the same Gaussians give the same bytes.

use std::cmp::Ordering;

use rayon::prelude::*;

pub(super) const LEVELS: usize = 256;
/// Rounds until the values of a scalar codebook hardly move.
const SCALAR_ROUNDS: usize = 60;
/// Bins of the histogram that the first values are chosen by.
const BINS: usize = 4096;
const MAX_VECTORS: usize = 1 << 16;
/// Rounds within a part of the vectors.
const PART_ROUNDS: usize = 4;
/// Rounds over all vectors, in which each may change its part.
const WHOLE_ROUNDS: usize = 2;
/// Number of nearest parts whose vectors are compared.
const NEAREST_PARTS: usize = 4;

/// Returns 256 ascending values, and for each number the index of the nearest. Up to 256 different numbers are kept exactly.
pub(super) fn scalar_codebook(numbers: &[f32]) -> ([f32; LEVELS], Vec<u8>) {
    let mut sorted = numbers.to_vec();
    sorted.par_sort_unstable_by(f32::total_cmp);
    let mut distinct = sorted.clone();
    distinct.dedup();
    let book: Vec<f32> = if distinct.len() <= LEVELS { distinct } else { lloyd(&sorted) };
    let last = book.last().copied().unwrap_or(0.0);
    let book: [f32; LEVELS] = std::array::from_fn(|i| *book.get(i).unwrap_or(&last));
    (book, numbers.par_iter().map(|&number| nearest(&book, number)).collect())
}

/// Index of the nearest of ascending values; the first of equal ones.
fn nearest(book: &[f32; LEVELS], number: f32) -> u8 {
    let above = book.partition_point(|&value| value < number).min(LEVELS - 1);
    let below = above.saturating_sub(1);
    let is_below = number - book[below] <= book[above] - number;
    let found = if is_below { below } else { above };
    book.partition_point(|&value| value < book[found]) as u8
}

fn lloyd(sorted: &[f32]) -> Vec<f32> {
    let mut book = first_values(sorted);
    for _ in 0..SCALAR_ROUNDS {
        let mut first = 0;
        let next = (0..book.len()).map(|i| {
            let end = match book.get(i + 1) {
                Some(next) => sorted.partition_point(|&v| f64::from(v) < (book[i] + next) / 2.0).max(first),
                None => sorted.len(),
            };
            let sum: f64 = sorted[first..end].iter().copied().map(f64::from).sum();
            let mean = if end > first { sum / (end - first) as f64 } else { book[i] };
            first = end;
            mean
        });
        book = next.collect();
    }
    book.into_iter().map(|value| value as f32).collect()
}

/// Values whose density is the cube root of the numbers' density, which is best for many values (Panter and Dite). The bins
/// divide the range without the farthest thousandths, so that an outlier does not leave all others in one bin. Within a bin the
/// values have equal numbers between them.
fn first_values(sorted: &[f32]) -> Vec<f64> {
    let tail = sorted.len() / 1000;
    let [min, max] = [sorted[tail], sorted[sorted.len() - 1 - tail]].map(f64::from);
    let mut ends = vec![0];
    ends.extend((1..=BINS).map(|bin| {
        let edge = min + (max - min) * bin as f64 / BINS as f64;
        if bin == BINS { sorted.len() } else { sorted.partition_point(|&v| f64::from(v) < edge) }
    }));
    let mut cumulated = vec![0.0];
    for bin in ends.windows(2) {
        cumulated.push(cumulated[cumulated.len() - 1] + ((bin[1] - bin[0]) as f64).cbrt());
    }
    let value = |i: usize| {
        let wanted = cumulated[BINS] * (i as f64 + 0.5) / LEVELS as f64;
        let bin = cumulated.partition_point(|&c| c <= wanted).clamp(1, BINS) - 1;
        let share = (wanted - cumulated[bin]) / (cumulated[bin + 1] - cumulated[bin]);
        let rank = ends[bin] + (share * (ends[bin + 1] - ends[bin]) as f64) as usize;
        f64::from(sorted[rank.min(sorted.len() - 1)])
    };
    (0..LEVELS).map(value).collect()
}

/// A palette of vectors, with 256 different values in all.
pub(super) struct Palette {
    pub(super) book: [f32; LEVELS],
    /// Indices of the values of all vectors, one vector after the other.
    pub(super) vectors: Vec<u8>,
    /// For each input, its vector.
    pub(super) labels: Vec<u16>,
}

impl Palette {
    /// Finds the palette of inputs of `length` numbers each. It has up to 65,536 vectors. Where there are no more different
    /// inputs, it holds them exactly.
    pub(super) fn of(numbers: &[f32], length: usize) -> Self {
        let inputs = Vectors { numbers, length };
        let size = palette_size(inputs.len());
        let (distinct, weights, places) = distinct(inputs);
        let inputs = Vectors { numbers: &distinct, length };
        let (centers, labels) = match inputs.len() <= size {
            true => (distinct, (0..weights.len() as u32).collect()),
            false => cluster(&Weighted { inputs, weights: &weights }, size),
        };
        let (book, vectors) = scalar_codebook(&centers);
        Self { book, vectors, labels: places.iter().map(|&place| labels[place as usize] as u16).collect() }
    }
}

/// The different vectors, how often each occurs, and the place of each input's.
fn distinct(inputs: Vectors<'_>) -> (Vec<f32>, Vec<u32>, Vec<u32>) {
    let compare = |a: &u32, b: &u32| {
        let pairs = inputs.at(*a as usize).iter().zip(inputs.at(*b as usize));
        pairs.map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
    };
    let mut order: Vec<u32> = (0..inputs.len() as u32).collect();
    order.par_sort_by(compare);
    let (mut numbers, mut weights, mut places) = (Vec::new(), Vec::new(), vec![0; order.len()]);
    for group in order.chunk_by(|a, b| compare(a, b).is_eq()) {
        numbers.extend_from_slice(inputs.at(group[0] as usize));
        group.iter().for_each(|&input| places[input as usize] = weights.len() as u32);
        weights.push(group.len() as u32);
    }
    (numbers, weights, places)
}

/// Number of vectors, as in the format's first writer, so that files have its sizes.
fn palette_size(inputs: usize) -> usize {
    match inputs / 1024 {
        0 => inputs,
        thousands => ((1 << thousands.ilog2()) * 1024).min(MAX_VECTORS),
    }
}

/// Vectors of one length, one after the other.
#[derive(Clone, Copy)]
struct Vectors<'a> {
    numbers: &'a [f32],
    length: usize,
}

impl<'a> Vectors<'a> {
    fn len(self) -> usize {
        self.numbers.len() / self.length
    }

    fn at(self, index: usize) -> &'a [f32] {
        &self.numbers[index * self.length..(index + 1) * self.length]
    }

    /// Number of the nearest vector and its squared distance; the first of equal ones.
    fn nearest(self, vector: &[f32]) -> (u32, f32) {
        (0..self.len()).fold((0, f32::INFINITY), |best, index| {
            let distance = squared_distance(vector, self.at(index));
            if distance < best.1 { (index as u32, distance) } else { best }
        })
    }
}

/// Different vectors, and how often each occurs.
struct Weighted<'a> {
    inputs: Vectors<'a>,
    weights: &'a [u32],
}

/// Eight sums side by side, so that the compiler uses vector instructions and the result does not depend on them.
fn squared_distance(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0f32; 8];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..8 {
            let difference = a[lane] - b[lane];
            sums[lane] += difference * difference;
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| (a - b) * (a - b)).sum();
    sums.iter().sum::<f32>() + rest
}

/// Centers and each input's center. The inputs are first divided into parts, each with its share of the centers, so that an
/// input is compared with hundreds of centers in place of 65,536.
fn cluster(weighted: &Weighted<'_>, size: usize) -> (Vec<f32>, Vec<u32>) {
    let inputs = weighted.inputs;
    let length = inputs.length;
    let parts = 1 << size.ilog2().div_ceil(2);
    let all: Vec<u32> = (0..inputs.len() as u32).collect();
    let mut heads = spread(inputs, &all, parts);
    let mut part_of = Vec::new();
    for _ in 0..PART_ROUNDS {
        part_of = all
            .par_iter()
            .map(|&i| Vectors { numbers: &heads, length }.nearest(inputs.at(i as usize)).0)
            .collect();
        move_to_means(weighted, &all, &part_of, &mut heads);
    }
    let mut members = vec![Vec::new(); parts];
    all.iter().zip(&part_of).for_each(|(&input, &part)| members[part as usize].push(input));
    let shares = shares(&members, size);
    let found: Vec<Vec<f32>> = members
        .par_iter()
        .zip(&shares)
        .map(|(members, &share)| {
            let mut centers = spread(inputs, members, share);
            for _ in 0..PART_ROUNDS {
                let own = Vectors { numbers: &centers, length };
                let labels: Vec<u32> =
                    members.iter().map(|&i| own.nearest(inputs.at(i as usize)).0).collect();
                move_to_means(weighted, members, &labels, &mut centers);
            }
            centers
        })
        .collect();
    let firsts: Vec<usize> = shares
        .iter()
        .scan(0, |next, share| {
            let first = *next;
            *next += share;
            Some(first)
        })
        .collect();
    let mut centers: Vec<f32> = found.concat();
    let heads = Vectors { numbers: &heads, length };
    let near_parts: Vec<[u32; NEAREST_PARTS]> =
        all.par_iter().map(|&i| nearest_parts(&heads, inputs.at(i as usize))).collect();
    let assign = |centers: &[f32]| -> Vec<u32> {
        let nearest = |(&input, near): (&u32, &[u32; NEAREST_PARTS])| {
            let input = inputs.at(input as usize);
            let best = near.iter().filter(|&&part| shares[part as usize] > 0).map(|&part| {
                let (first, share) = (firsts[part as usize], shares[part as usize]);
                let own = Vectors { numbers: &centers[first * length..(first + share) * length], length };
                let (index, distance) = own.nearest(input);
                (first as u32 + index, distance)
            });
            best.fold((0, f32::INFINITY), |a, b| if b.1 < a.1 { b } else { a }).0
        };
        all.par_iter().zip(&near_parts).map(nearest).collect()
    };
    for _ in 0..WHOLE_ROUNDS {
        let labels = assign(&centers);
        move_to_means(weighted, &all, &labels, &mut centers);
    }
    let labels = assign(&centers);
    (centers, labels)
}

/// Vectors at equal distances in the list of members.
fn spread(inputs: Vectors<'_>, members: &[u32], count: usize) -> Vec<f32> {
    (0..count).flat_map(|i| inputs.at(members[i * members.len() / count] as usize)).copied().collect()
}

/// Moves each center to the mean of its members. A center without members stays.
fn move_to_means(
    Weighted { inputs, weights }: &Weighted<'_>,
    members: &[u32],
    labels: &[u32],
    centers: &mut [f32],
) {
    let length = inputs.length;
    let mut counts = vec![0u32; centers.len() / length];
    let mut sums = vec![0.0f64; centers.len()];
    for (&member, &label) in members.iter().zip(labels) {
        let weight = weights[member as usize];
        counts[label as usize] += weight;
        let sums = &mut sums[label as usize * length..][..length];
        sums.iter_mut()
            .zip(inputs.at(member as usize))
            .for_each(|(sum, &value)| *sum += f64::from(weight) * f64::from(value));
    }
    for ((center, sums), &count) in centers.chunks_mut(length).zip(sums.chunks(length)).zip(&counts) {
        if count > 0 {
            center.iter_mut().zip(sums).for_each(|(value, sum)| *value = (sum / f64::from(count)) as f32);
        }
    }
}

/// Divides `size` centers among the parts by their numbers of members. None has more centers than members.
fn shares(members: &[Vec<u32>], size: usize) -> Vec<usize> {
    let all: usize = members.iter().map(Vec::len).sum();
    let mut seen = 0;
    members
        .iter()
        .map(|members| {
            let before = seen * size / all;
            seen += members.len();
            (seen * size / all) - before
        })
        .collect()
}

fn nearest_parts(heads: &Vectors<'_>, input: &[f32]) -> [u32; NEAREST_PARTS] {
    let mut best = [(f32::INFINITY, 0); NEAREST_PARTS];
    for index in 0..heads.len() {
        let found = (squared_distance(input, heads.at(index)), index as u32);
        if found.0 < best[NEAREST_PARTS - 1].0 {
            let place = best.partition_point(|other| other.0 <= found.0);
            best.copy_within(place..NEAREST_PARTS - 1, place + 1);
            best[place] = found;
        }
    }
    best.map(|(_, index)| index)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::growth::turn;
    use rand::{RngExt, SeedableRng};

    fn numbers(count: usize) -> Vec<f32> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        // Long tails, as spherical harmonics have.
        (0..count).map(|_| (random.random_range(-1.0_f32..1.0)).powi(5)).collect()
    }

    fn error(inputs: Vectors<'_>, centers: &[f32], labels: &[u32]) -> f64 {
        let centers = Vectors { numbers: centers, length: inputs.length };
        let distance = |(i, &label)| f64::from(squared_distance(inputs.at(i), centers.at(label as usize)));
        labels.iter().enumerate().map(distance).sum()
    }

    #[test]
    fn few_numbers_are_kept_and_many_are_near_a_value() {
        let _turn = turn();
        let few: Vec<f32> = numbers(200).repeat(3);
        let (book, indices) = scalar_codebook(&few);
        assert!(few.iter().zip(&indices).all(|(&number, &i)| book[usize::from(i)] == number));
        let mut many = numbers(20_000);
        many[7] = 1e30;
        let (book, indices) = scalar_codebook(&many);
        let error = |book: &[f32; LEVELS], i: usize| f64::from(book[i]);
        let squares =
            many.iter().zip(&indices).map(|(&n, &i)| (f64::from(n) - error(&book, i.into())).powi(2));
        // Equal steps have a mean square of step² / 12. The best values for this density have 0.51 of that (Panter and Dite).
        let equal = many.len() as f64 * (2.0 / 256.0_f64).powi(2) / 12.0;
        assert!(squares.sum::<f64>() < 0.6 * equal);
    }

    #[test]
    fn parts_cost_little_beside_comparing_with_all_centers() {
        let _turn = turn();
        let (length, size) = (9, 256);
        let all = numbers(9 * 5000);
        let inputs = Vectors { numbers: &all, length };
        let weighted = Weighted { inputs, weights: &vec![1; 5000] };
        let (centers, labels) = cluster(&weighted, size);
        let members: Vec<u32> = (0..5000).collect();
        let mut plain = spread(inputs, &members, size);
        let mut own = Vec::new();
        for _ in 0..10 {
            let now = Vectors { numbers: &plain, length };
            own = members.iter().map(|&i| now.nearest(inputs.at(i as usize)).0).collect();
            move_to_means(&weighted, &members, &own, &mut plain);
        }
        let (parts, whole) = (error(inputs, &centers, &labels), error(inputs, &plain, &own));
        assert!(parts <= 1.05 * whole, "{parts} {whole}");
    }
}
