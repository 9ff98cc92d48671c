//! Memory that invocations share, with the last accesses to each word.

use crate::arithmetic::POISON;
use crate::program::{Kind, Memory};
use std::cell::Cell;
use std::rc::Rc;

/// An access: its invocation, and its time in numbers of barriers.
#[derive(Clone, Copy, Default)]
pub(crate) struct Moment {
    /// Number of the subgroup in the dispatch, from 1 on; 0 for no access.
    pub(crate) subgroup: u32,
    pub(crate) workgroup: u32,
    pub(crate) lane: u8,
    /// Numbers of the workgroup's and of the subgroup's barriers for this kind of memory, in this workgroup.
    pub(crate) barriers: u32,
    pub(crate) own_barriers: u32,
    pub(crate) is_atomic: bool,
    /// True if other lanes of the subgroup have accessed the word, too.
    pub(crate) is_many: bool,
}

impl Moment {
    /// True if nothing orders an access after an earlier one.
    fn races(&self, earlier: &Self) -> bool {
        if earlier.subgroup == 0 || (self.is_atomic && earlier.is_atomic) {
            return false;
        }
        if earlier.workgroup != self.workgroup {
            return true;
        }
        if earlier.barriers != self.barriers {
            return false;
        }
        let is_same_lane = earlier.lane == self.lane && !earlier.is_many;
        earlier.subgroup != self.subgroup || (earlier.own_barriers == self.own_barriers && !is_same_lane)
    }
}

/// Last accesses to a word, with two reads of different subgroups.
#[derive(Clone, Copy, Default)]
struct Touched {
    writer: Moment,
    readers: [Moment; 2],
}

impl Touched {
    fn read(&mut self, now: Moment) {
        let [last, before] = &mut self.readers;
        if last.subgroup != now.subgroup {
            *before = *last;
            *last = now;
        } else {
            let is_same_time = (last.barriers, last.own_barriers) == (now.barriers, now.own_barriers);
            let is_many = is_same_time && (last.is_many || last.lane != now.lane);
            *last = Moment { is_many, ..now };
        }
    }
}

/// Per workgroup: number of its barriers for buffers before its last atomic access to one. What it did before them is ordered
/// before other workgroups that made such an access and have passed a barrier since. No check compares the words.
pub(crate) type Arrivals = Rc<[Cell<u32>]>;

pub(crate) struct Words {
    pub(crate) name: String,
    pub(crate) words: Vec<u32>,
    /// Empty for read-only memory.
    touched: Vec<Touched>,
    pub(crate) is_shared: bool,
    accepts_unwritten: bool,
    arrivals: Arrivals,
}

impl Words {
    pub(crate) fn new(memory: &Memory, words: Vec<u32>, accepts_unwritten: bool, arrivals: Arrivals) -> Self {
        let is_writable = matches!(memory.kind, Kind::Shared { .. } | Kind::Buffer { writable: true, .. });
        Self {
            name: memory.name.clone(),
            touched: if is_writable { vec![Touched::default(); words.len()] } else { Vec::new() },
            words,
            is_shared: matches!(memory.kind, Kind::Shared { .. }),
            accepts_unwritten,
            arrivals,
        }
    }

    /// Resets shared memory for a workgroup.
    pub(crate) fn forget(&mut self) {
        if self.is_shared {
            self.words.fill(POISON);
            self.touched.fill(Touched::default());
        }
    }

    fn races(&self, now: &Moment, earlier: &Moment) -> bool {
        let [own, other] = [now, earlier].map(|moment| self.arrivals[moment.workgroup as usize].get());
        now.races(earlier) && !(now.barriers > own && own > 0 && earlier.barriers < other)
    }

    fn check(&self, place: u64, what: &str) -> Result<usize, String> {
        if place < self.words.len() as u64 {
            return Ok(place as usize);
        }
        Err(format!("{what} word {place} of '{}', which has {}", self.name, self.words.len()))
    }

    fn race(&self, place: usize, what: &str, (other, done): (&Moment, &str)) -> String {
        format!(
            "{what} word {place} of '{}', which lane {} of subgroup {} of the dispatch {done} without a barrier between",
            self.name,
            other.lane,
            other.subgroup - 1
        )
    }

    pub(crate) fn load(&mut self, place: u64, now: Moment) -> Result<u32, String> {
        let place = self.check(place, "reads")?;
        if let Some(touched) = self.touched.get_mut(place) {
            let writer = touched.writer;
            touched.read(now);
            if self.races(&now, &writer) {
                return Err(self.race(place, "reads", (&writer, "has written")));
            }
            if self.is_shared && writer.subgroup == 0 && !self.accepts_unwritten {
                return Err(format!("reads word {place} of '{}', which nobody has written", self.name));
            }
        }
        Ok(self.words[place])
    }

    pub(crate) fn store(&mut self, place: u64, word: u32, now: Moment) -> Result<(), String> {
        let place = self.check(place, "writes")?;
        let Some(touched) = self.touched.get_mut(place) else {
            return Err(format!("writes word {place} of '{}', which is declared readonly", self.name));
        };
        let Touched { writer, readers } = *touched;
        touched.writer = now;
        // Writing the same value affects no other access.
        if self.words[place] != word {
            if self.races(&now, &writer) {
                return Err(self.race(place, "writes", (&writer, "has written")));
            }
            if let Some(reader) = readers.iter().find(|reader| self.races(&now, reader)) {
                return Err(self.race(place, "writes", (reader, "has read")));
            }
        }
        self.words[place] = word;
        Ok(())
    }

    /// Replaces a word by its new value; returns the old one.
    pub(crate) fn change(
        &mut self,
        place: u64,
        now: Moment,
        new: impl Fn(u32) -> u32,
    ) -> Result<u32, String> {
        let now = Moment { is_atomic: true, ..now };
        if !self.is_shared {
            self.arrivals[now.workgroup as usize].set(now.barriers);
        }
        let old = self.load(place, now)?;
        self.store(place, new(old), now)?;
        Ok(old)
    }
}
