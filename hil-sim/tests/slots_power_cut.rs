//! Power cuts at every flash operation of a slot write, in every torn form, with a second and a third cut in recovery.
//! The record is the old or the new one, what one boot has shown stays, and an acknowledged write is never lost.

use firmware::slots::{PAIRS, SlotError, Slots};
use hil_sim::robot::flash::{Cut, RamFlash, TEARS, Tear};

const PAIR: usize = 3;

fn payload(number: u8) -> Vec<u8> {
    (0..190u8).map(|i| i.wrapping_mul(31) ^ number).collect()
}

/// Boots, possibly into another cut; `Some(content)` when the boot completed with power on.
fn boot(flash: &mut RamFlash) -> Option<Option<Vec<u8>>> {
    let mut slots = Slots::new();
    slots.recover(flash);
    let content = content(&slots, flash);
    flash.is_powered().then_some(content)
}

fn content(slots: &Slots, flash: &mut RamFlash) -> Option<Vec<u8>> {
    let mut buffer = [0; 256];
    match slots.read(flash, PAIR, &mut buffer) {
        Ok(len) => Some(buffer[..len].to_vec()),
        Err(SlotError::Empty) => None,
        Err(_) if !flash.is_powered() => None,
        Err(error) => panic!("a listed record cannot be read: {error:?}"),
    }
}

/// A flash with records written before, both pages of the pair used.
fn used_flash(seed: u64) -> RamFlash {
    let mut flash = RamFlash::new(seed);
    let mut slots = Slots::new();
    slots.recover(&mut flash);
    for number in 0..3 {
        slots
            .write(&mut flash, PAIR, &payload(number))
            .expect("a healthy flash takes the record");
    }
    flash
}

/// Writes `payload(9)` over `payload(2)` with a cut; returns the flash and whether the write was acknowledged.
fn cut_write(seed: u64, cut: Cut) -> (RamFlash, bool) {
    let mut flash = used_flash(seed);
    let mut slots = Slots::new();
    slots.recover(&mut flash);
    flash.plan_cut(cut);
    let acknowledged = slots.write(&mut flash, PAIR, &payload(9)).is_ok();
    (flash, acknowledged)
}

fn check_final(flash: &mut RamFlash, acknowledged: bool, seed: u64, label: &str) {
    flash.power_on();
    flash.reseed(seed ^ 0x5EED);
    let shown = boot(flash).expect("no cut is planned");
    let old = shown == Some(payload(2));
    assert!(
        old || shown == Some(payload(9)),
        "{label}: neither old nor new"
    );
    assert!(
        !(old && acknowledged),
        "{label}: an acknowledged write was lost"
    );
    for later in 0..4 {
        flash.power_on();
        flash.reseed(seed.wrapping_add(later * 7919));
        assert_eq!(
            boot(flash),
            Some(shown.clone()),
            "{label}: boot {later} shows another record"
        );
    }
    let mut slots = Slots::new();
    slots.recover(flash);
    slots
        .write(flash, PAIR, &payload(77))
        .expect("the slot takes a new record");
    assert_eq!(boot(flash), Some(Some(payload(77))), "{label}");
}

#[test]
fn every_cut_with_two_nested_cuts_in_recovery_leaves_old_or_new() {
    let (flash, _) = cut_write(
        0,
        Cut {
            after: u64::MAX,
            tear: TEARS[0],
        },
    );
    let operations = flash.operations();
    let (mut schedules, mut double_programs) = (0_u64, 0);
    for after in 0..=operations {
        for (t, tear) in TEARS.into_iter().enumerate() {
            for seed in 0..3 {
                let (torn, acknowledged) = cut_write(seed, Cut { after, tear });
                let mut second = vec![None];
                second.extend((0..4).flat_map(|after| TEARS.map(|tear| Some(Cut { after, tear }))));
                for cut2 in &second {
                    for cut3 in if cut2.is_some() {
                        &second[..]
                    } else {
                        &second[..1]
                    } {
                        let mut flash = torn.clone();
                        let mut label = format!("cut {after} {tear:?} seed {seed}");
                        for cut in [cut2, cut3].into_iter().flatten() {
                            flash.power_on();
                            flash.reseed(seed * 1000 + t as u64 + schedules);
                            flash.plan_cut(*cut);
                            boot(&mut flash);
                            label += &format!(" then {cut:?}");
                        }
                        check_final(&mut flash, acknowledged, seed + schedules, &label);
                        double_programs += flash.double_programs();
                        schedules += 1;
                    }
                }
            }
        }
    }
    println!(
        "{operations} operations per write, {schedules} schedules of up to three cuts, {double_programs} refused programs"
    );
    assert!(schedules > 100_000);
}

#[test]
fn a_thousand_stores_with_random_cuts_lose_no_acknowledged_record() {
    let mut flash = used_flash(1);
    let mut last = payload(2);
    let mut cuts = 0;
    let mut random = 0x2545_F491_4F6C_DD1D_u64;
    for number in 0..1000_u32 {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        let mut slots = Slots::new();
        slots.recover(&mut flash);
        let mut next = payload(number as u8);
        next.extend(number.to_le_bytes());
        flash.plan_cut(Cut {
            after: random % 60,
            tear: TEARS[(random >> 32) as usize % TEARS.len()],
        });
        let acknowledged = slots.write(&mut flash, PAIR, &next).is_ok();
        cuts += u32::from(!flash.is_powered());
        flash.power_on();
        let shown = boot(&mut flash).flatten().expect("never empty");
        assert!(
            shown == next || !acknowledged && shown == last,
            "store {number}"
        );
        last = shown;
    }
    println!("1000 stores, {cuts} cuts");
}

#[test]
fn records_of_other_slots_are_untouched_and_erase_is_atomic() {
    let mut flash = used_flash(5);
    let mut slots = Slots::new();
    slots.recover(&mut flash);
    slots
        .write(&mut flash, 4, &payload(4))
        .expect("a healthy flash takes the record");
    let (mut empty, mut kept) = (0, 0);
    for after in 0..8 {
        for tear in TEARS {
            let mut flash = flash.clone();
            let mut slots = Slots::new();
            slots.recover(&mut flash);
            flash.plan_cut(Cut { after, tear });
            let done = slots.erase(&mut flash, PAIR).is_ok();
            flash.power_on();
            slots.recover(&mut flash);
            match content(&slots, &mut flash) {
                None => empty += 1,
                Some(record) => {
                    assert!(!done && record == payload(2));
                    kept += 1;
                }
            }
            let mut buffer = [0; 256];
            assert_eq!(slots.read(&mut flash, 4, &mut buffer), Ok(190));
        }
    }
    assert!(empty > 0 && kept > 0);
}

#[test]
fn limits_are_refused_and_named() {
    let mut flash = RamFlash::new(0);
    let mut slots = Slots::new();
    slots.recover(&mut flash);
    let mut small = [0; 8];
    assert_eq!(slots.read(&mut flash, 0, &mut small), Err(SlotError::Empty));
    assert_eq!(
        slots.read(&mut flash, 99, &mut small),
        Err(SlotError::NoSuchSlot)
    );
    assert_eq!(
        slots.write(&mut flash, 99, &[1]),
        Err(SlotError::NoSuchSlot)
    );
    for pair in [PAIRS, 99] {
        assert_eq!(slots.erase(&mut flash, pair), Err(SlotError::NoSuchSlot));
    }
    assert_eq!(slots.erase(&mut flash, PAIRS - 1), Ok(()));
    assert_eq!(
        slots.write(&mut flash, 0, &[0; 4096]),
        Err(SlotError::TooLong)
    );
    slots
        .write(&mut flash, 0, &[0xFF; 40])
        .expect("a healthy flash takes the record");
    assert_eq!(
        slots.read(&mut flash, 0, &mut small),
        Err(SlotError::TooLong)
    );
    assert_eq!(slots.len(0), Some(40));
}

/// Two words that were cut may both read right in one boot and wrong in the next: two verdicts alone are no record.
#[test]
fn two_verdicts_that_were_cut_are_not_trusted() {
    let (whole, _) = cut_write(
        0,
        Cut {
            after: u64::MAX,
            tear: TEARS[0],
        },
    );
    let operations = whole.operations();
    for seed in 0..3_000 {
        // The first COMMIT word is the third operation from the end.
        let tear = Tear::Unstable;
        let after = operations - 3;
        let (mut flash, acknowledged) = cut_write(seed, Cut { after, tear });
        flash.power_on();
        flash.reseed(seed + 1_000_000);
        flash.plan_cut(Cut { after: 0, tear });
        boot(&mut flash);
        check_final(&mut flash, acknowledged, seed, &format!("seed {seed}"));
    }
}

/// A word that the flash keeps wrong without saying so is found by reading it back, or the write is refused.
#[test]
fn a_worn_out_flash_loses_no_acknowledged_record() {
    let (mut stored, mut refused) = (0, 0);
    for seed in 0..400_u64 {
        let mut flash = used_flash(seed);
        let mut last = payload(2);
        for number in 0..20_u8 {
            let mut slots = Slots::new();
            flash.wear_out(0);
            slots.recover(&mut flash);
            // A short record and many weak words: the verdicts are what fails.
            flash.wear_out(2 + seed as u32 % 4);
            let next = vec![number; 4];
            if slots.write(&mut flash, PAIR, &next).is_ok() {
                last = next;
                stored += 1;
            } else {
                refused += 1;
            }
            flash.wear_out(0);
            assert_eq!(boot(&mut flash), Some(Some(last.clone())), "seed {seed}");
        }
    }
    assert!(stored > 500 && refused > 50, "{stored} {refused}");
}
