//! The slot flash in RAM, with the STM32L4's rules and a power cut at any operation.
//!
//! Rules: 64-bit words with ECC, each programmed once between two erases of its page (RM0351 section 3.3.7: PROGERR
//! otherwise), erase by page. A cut leaves the word (or every word of the page under erase) in one of [`Tear`]'s forms.
//! What a cut word reads like is our model, on the hostile side; only silicon shows the real distribution.

use firmware::ports::{FlashError, PAGE_WORDS, STORE_PAGES, SlotStore, WORD_BYTES};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

type Word = [u8; WORD_BYTES];
const ERASED: Word = [0xFF; WORD_BYTES];

/// What a power cut leaves of the word that was being written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tear {
    /// Nothing happened yet.
    NotStarted,
    /// It was complete, though nobody could note it.
    Complete,
    /// The first half of the bytes changed; reads without an ECC error.
    Half,
    /// A random subset of the bits changed; reads without an ECC error.
    RandomBits,
    /// Uncorrectable: every read raises the NMI.
    EccError,
    /// Every read gives something else: old, new, a mixture, or an ECC error.
    Unstable,
}

/// All tears, for tests that try each.
pub const TEARS: [Tear; 6] = [
    Tear::NotStarted,
    Tear::Complete,
    Tear::Half,
    Tear::RandomBits,
    Tear::EccError,
    Tear::Unstable,
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cell {
    Stable(Word),
    Unreadable,
    Unstable { old: Word, new: Word },
}

/// A cut: the operation (erase or program, counted from 0 since [`RamFlash::plan_cut`]) during which power fails.
#[derive(Debug, Clone, Copy)]
pub struct Cut {
    /// Operations that complete before the one that is cut.
    pub after: u64,
    /// What is left of it.
    pub tear: Tear,
}

/// Emulated slot flash.
#[derive(Debug, Clone)]
pub struct RamFlash {
    pages: Vec<[Cell; PAGE_WORDS]>,
    rng: ChaCha8Rng,
    cut: Option<Cut>,
    /// Of so many programmed words one keeps a bit as it was, without an error; 0 = none.
    weak_every: u32,
    powered: bool,
    operations: u64,
    erases: u64,
    double_programs: u64,
}

impl RamFlash {
    /// An erased flash. `seed` drives torn and unstable words only.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            pages: vec![[Cell::Stable(ERASED); PAGE_WORDS]; STORE_PAGES],
            rng: ChaCha8Rng::seed_from_u64(seed),
            cut: None,
            weak_every: 0,
            powered: true,
            operations: 0,
            erases: 0,
            double_programs: 0,
        }
    }

    /// Power fails at the given operation, counted from now.
    pub fn plan_cut(&mut self, cut: Cut) {
        self.cut = Some(cut);
        self.operations = 0;
    }

    /// Worn out: from now on one programmed word of `every` keeps a bit as the erase left it, and no error says so. 0 = as new.
    pub fn wear_out(&mut self, every: u32) {
        self.weak_every = every;
    }

    /// True until a planned cut has happened.
    #[must_use]
    pub fn is_powered(&self) -> bool {
        self.powered
    }

    /// Power is back; no cut is planned. Unstable words stay unstable.
    pub fn power_on(&mut self) {
        self.powered = true;
        self.cut = None;
        self.operations = 0;
    }

    /// Other random bits for torn and unstable words from here on.
    pub fn reseed(&mut self, seed: u64) {
        self.rng = ChaCha8Rng::seed_from_u64(seed);
    }

    /// Erase and program operations since the last plan or power-on.
    #[must_use]
    pub fn operations(&self) -> u64 {
        self.operations
    }

    /// Page erases since the beginning.
    #[must_use]
    pub fn erases(&self) -> u64 {
        self.erases
    }

    /// Attempts to program a word that was not erased; each was refused.
    #[must_use]
    pub fn double_programs(&self) -> u64 {
        self.double_programs
    }

    /// Counts an operation; `Some(tear)` when power fails during it.
    fn tick(&mut self) -> Result<Option<Tear>, FlashError> {
        if !self.powered {
            return Err(FlashError::Controller);
        }
        let number = self.operations;
        self.operations += 1;
        match self.cut {
            Some(cut) if cut.after == number => {
                self.powered = false;
                Ok(Some(cut.tear))
            }
            _ => Ok(None),
        }
    }

    fn torn(&mut self, old: Cell, new: Word, tear: Tear) -> Cell {
        let was = match old {
            Cell::Stable(word) => word,
            // An unsettled word stays unsettled unless the operation completes.
            Cell::Unreadable | Cell::Unstable { .. } if tear != Tear::Complete => return old,
            Cell::Unreadable | Cell::Unstable { .. } => new,
        };
        match tear {
            Tear::NotStarted => old,
            Tear::Complete => Cell::Stable(new),
            Tear::Half => {
                let mut word = was;
                word[..WORD_BYTES / 2].copy_from_slice(&new[..WORD_BYTES / 2]);
                Cell::Stable(word)
            }
            Tear::RandomBits => Cell::Stable(mix(was, new, self.rng.next_u64())),
            Tear::EccError => Cell::Unreadable,
            Tear::Unstable => Cell::Unstable { old: was, new },
        }
    }
}

/// Takes each bit from `new` where `mask` is one, else from `old`.
fn mix(old: Word, new: Word, mask: u64) -> Word {
    (u64::from_le_bytes(old) & !mask | u64::from_le_bytes(new) & mask).to_le_bytes()
}

impl SlotStore for RamFlash {
    fn erase(&mut self, page: usize) -> Result<(), FlashError> {
        if page >= STORE_PAGES {
            return Err(FlashError::Range);
        }
        let tear = self.tick()?.unwrap_or(Tear::Complete);
        self.erases += 1;
        for word in 0..PAGE_WORDS {
            self.pages[page][word] = self.torn(self.pages[page][word], ERASED, tear);
        }
        if self.powered {
            Ok(())
        } else {
            Err(FlashError::Controller)
        }
    }

    fn program(&mut self, page: usize, word: usize, bytes: &Word) -> Result<(), FlashError> {
        if page >= STORE_PAGES || word >= PAGE_WORDS {
            return Err(FlashError::Range);
        }
        if self.pages[page][word] != Cell::Stable(ERASED) {
            self.double_programs += 1;
            return Err(FlashError::Controller);
        }
        let tear = self.tick()?.unwrap_or(Tear::Complete);
        let mut held = *bytes;
        if self.weak_every > 0 && self.rng.next_u32().is_multiple_of(self.weak_every) {
            let bit = self.rng.next_u64() % u64::from(u64::BITS);
            held = (u64::from_le_bytes(held) | 1 << bit).to_le_bytes();
        }
        self.pages[page][word] = self.torn(self.pages[page][word], held, tear);
        if self.powered {
            Ok(())
        } else {
            Err(FlashError::Controller)
        }
    }

    fn read(&mut self, page: usize, word: usize) -> Result<Word, FlashError> {
        if page >= STORE_PAGES || word >= PAGE_WORDS {
            return Err(FlashError::Range);
        }
        if !self.powered {
            return Err(FlashError::Controller);
        }
        match self.pages[page][word] {
            Cell::Stable(bytes) => Ok(bytes),
            Cell::Unreadable => Err(FlashError::Ecc),
            Cell::Unstable { old, new } => match self.rng.next_u32() % 4 {
                0 => Ok(old),
                1 => Ok(new),
                2 => Ok(mix(old, new, self.rng.next_u64())),
                _ => Err(FlashError::Ecc),
            },
        }
    }
}
