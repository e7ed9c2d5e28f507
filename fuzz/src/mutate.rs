//! Mutations from a seed, for machines without libFuzzer. They know no coverage: inputs come from a corpus alone.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};

/// Values at which numbers end, and words that mean something to a parser.
const WORDS: &[&str] = &[
    "nan",
    "inf",
    "-inf",
    "-0",
    "0",
    "1e308",
    "1e-320",
    "4294967296",
    "-1",
    "0x10",
    "[",
    "]",
    "[[",
    "{",
    "}",
    "=",
    "\"",
    "'''",
    "\n",
    ",",
    ".",
    "#",
    "\u{1b}[2J",
    "\u{202e}",
    "../",
    "/dev/zero",
    "<script>",
    "]]>",
    "\u{0}",
    "\u{feff}",
    "_deg",
    "_rad",
];

/// Makes new inputs of old ones.
#[derive(Debug)]
pub struct Mutator {
    rng: ChaCha8Rng,
    longest: usize,
    text: bool,
}

impl Mutator {
    /// `longest`: bytes of the longest input.
    #[must_use]
    pub fn new(seed: u64, longest: usize, text: bool) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(seed),
            longest,
            text,
        }
    }

    fn below(&mut self, end: usize) -> usize {
        (self.rng.next_u64() % end.max(1) as u64) as usize
    }

    /// One input of the corpus, changed in one to eight places.
    #[must_use]
    pub fn next(&mut self, corpus: &[Vec<u8>]) -> Vec<u8> {
        let pick = self.below(corpus.len());
        let mut data = corpus.get(pick).cloned().unwrap_or_default();
        for _ in 0..=self.below(8) {
            self.change(&mut data, corpus);
        }
        data.truncate(self.longest);
        data
    }

    fn change(&mut self, data: &mut Vec<u8>, corpus: &[Vec<u8>]) {
        let at = self.below(data.len() + 1);
        let end = data.len().min(at + 1 + self.below(16));
        match self.below(if self.text { 9 } else { 7 }) {
            0 if at < data.len() => data[at] ^= 1 << self.below(8),
            1 if at < data.len() => data[at] = self.rng.next_u64() as u8,
            2 => data.insert(at, self.rng.next_u64() as u8),
            3 => drop(data.drain(at..end)),
            4 => {
                let part = data[at..end].to_vec();
                let to = self.below(data.len() + 1);
                data.splice(to..to, part);
            }
            5 => {
                let other = self.below(corpus.len());
                let from = corpus.get(other).map_or(&[][..], Vec::as_slice);
                let start = self.below(from.len() + 1);
                let stop = from.len().min(start + 1 + self.below(64));
                data.splice(at..end, from[start..stop].iter().copied());
            }
            6 => {
                let special = [0, 1, 0x7F, 0x80, 0xFE, 0xFF][self.below(6)];
                data[at..end].fill(special);
            }
            _ => {
                let word = WORDS[self.below(WORDS.len())];
                data.splice(at..end, word.bytes());
            }
        }
    }
}
