//! Slots in flash: any words on the pages, any order of writes and power cuts.

use firmware::ports::{PAGE_WORDS, STORE_PAGES, SlotStore, WORD_BYTES};
use firmware::slots::{PAIRS, SlotError, Slots};
use hil_sim::robot::flash::{Cut, RamFlash, TEARS};

use crate::Bytes;

/// Most operations of one input.
const OPERATIONS: usize = 48;

/// What a boot shows, a second boot shows too; an acknowledged write is read back, whatever stood on the pages before.
pub(crate) fn operations(data: &[u8]) {
    let mut input = Bytes::new(data);
    let mut flash = RamFlash::new(u64::from(input.byte()));
    let mut slots = Slots::new();
    slots.recover(&mut flash);
    for _ in 0..OPERATIONS {
        if input.is_empty() {
            break;
        }
        let (kind, pair) = (input.byte(), usize::from(input.byte()));
        match kind % 8 {
            0 => drop(slots.write(&mut flash, pair % (PAIRS + 1), input.block())),
            1 => drop(slots.erase(&mut flash, pair % (PAIRS + 1))),
            2 => {
                flash.power_on();
                slots = Slots::new();
                slots.recover(&mut flash);
            }
            3 => drop(program(
                &mut flash,
                pair,
                input.byte(),
                input.take(WORD_BYTES),
            )),
            4 => drop(flash.erase(pair % STORE_PAGES)),
            5 => flash.plan_cut(Cut {
                after: u64::from(input.byte()),
                tear: TEARS[pair % TEARS.len()],
            }),
            6 => forge(&mut flash, pair, &mut input),
            _ => drop(slots.read(&mut flash, pair % (PAIRS + 1), &mut [0; 64])),
        }
    }
    afterwards(&mut flash, input.byte());
}

fn program(
    flash: &mut RamFlash,
    page: usize,
    word: u8,
    bytes: &[u8],
) -> Result<(), firmware::ports::FlashError> {
    let mut whole = [0xFF; WORD_BYTES];
    whole[..bytes.len()].copy_from_slice(bytes);
    flash.program(page % STORE_PAGES, usize::from(word) % PAGE_WORDS, &whole)
}

/// A record with a right checksum on a page of the caller's choice, one byte of it changed.
fn forge(flash: &mut RamFlash, pair: usize, input: &mut Bytes<'_>) {
    let mut scratch = RamFlash::new(1);
    let mut slots = Slots::new();
    slots.recover(&mut scratch);
    let from = pair % PAIRS;
    let _ = slots.write(&mut scratch, from, input.block());
    let (to, at, change) = (input.byte(), input.byte(), input.byte());
    let to = usize::from(to) % STORE_PAGES;
    let _ = flash.erase(to);
    for source in [2 * from, 2 * from + 1] {
        for word in 0..PAGE_WORDS {
            let Ok(mut bytes) = scratch.read(source, word) else {
                continue;
            };
            if bytes == [0xFF; WORD_BYTES] {
                continue;
            }
            if word == usize::from(at) / WORD_BYTES {
                bytes[usize::from(at) % WORD_BYTES] ^= change;
            }
            let _ = flash.program(to, word, &bytes);
        }
    }
}

fn afterwards(flash: &mut RamFlash, seed: u8) {
    flash.power_on();
    let shown = contents(flash);
    flash.reseed(u64::from(seed) + 7);
    assert_eq!(contents(flash), shown, "a second boot shows something else");
    for pair in 0..PAIRS {
        let mut slots = Slots::new();
        slots.recover(flash);
        let payload = [seed ^ pair as u8; 40];
        match slots.write(flash, pair, &payload) {
            Ok(_) => {
                let mut again = Slots::new();
                again.recover(flash);
                let mut buffer = [0; 64];
                assert_eq!(again.read(flash, pair, &mut buffer), Ok(40), "pair {pair}");
                assert_eq!(buffer[..40], payload);
            }
            Err(error) => panic!("pair {pair} takes no record any more: {error:?}"),
        }
    }
}

/// What a boot makes of the flash.
fn contents(flash: &mut RamFlash) -> Vec<Option<Vec<u8>>> {
    let mut slots = Slots::new();
    slots.recover(flash);
    let pairs = 0..PAIRS;
    let read = |pair| {
        let mut buffer = [0; firmware::slots::PAYLOAD_BYTES];
        match slots.read(flash, pair, &mut buffer) {
            Ok(len) => Some(buffer[..len].to_vec()),
            Err(SlotError::Empty) => None,
            Err(error) => panic!("pair {pair} is listed and cannot be read: {error:?}"),
        }
    };
    pairs.map(read).collect()
}
