//! Bytes of the control table: what a range reads, and what a write of several registers does. Driver side.

use super::feedback::PACKED_LEN;
use super::indirect::Indirect;
use super::packet::{PacketBuf, StatusError};
use super::server::DriverHandler;
use super::table::{Access, OWN_END, OWN_START, PACKED_FEEDBACK, Register, TABLE, X_END};

/// Most runs of neighbouring targets in one write through the indirect data.
const MAX_RUNS: usize = 56;

/// Bytes of any range that begins and ends in one part of the table. Addresses without register read 0.
///
/// # Errors
/// A range outside the table, or longer than a packet.
pub(super) fn read<H: DriverHandler>(
    address: u16,
    len: u16,
    registered: bool,
    handler: &mut H,
    data: &mut PacketBuf,
) -> Result<(), StatusError> {
    let end = address.checked_add(len).ok_or(StatusError::Access)?;
    if len == 0 {
        return Err(StatusError::Access);
    }
    data.resize(usize::from(len), 0)
        .map_err(|_| StatusError::DataLength)?;
    let own = handler.indirect().is_none();
    if end <= X_END || (own && address >= OWN_START && end <= OWN_END) {
        read_direct(address, registered, handler, data);
        return Ok(());
    }
    match handler.indirect() {
        Some(map) if address >= map.start() && end <= map.end() => {
            read_indirect(address, registered, handler, data);
            Ok(())
        }
        _ => Err(StatusError::Access),
    }
}

fn read_direct<H: DriverHandler>(
    address: u16,
    registered: bool,
    handler: &mut H,
    data: &mut PacketBuf,
) {
    let end = address.saturating_add(data.len() as u16);
    for info in TABLE {
        let value = match info.register {
            Register::RegisteredInstruction => i32::from(registered),
            other => handler.read(other),
        };
        overlay(
            data,
            address,
            info.address,
            value
                .to_le_bytes()
                .get(..usize::from(info.len))
                .unwrap_or(&[]),
        );
    }
    if address < PACKED_FEEDBACK + PACKED_LEN as u16 && end > PACKED_FEEDBACK {
        overlay(
            data,
            address,
            PACKED_FEEDBACK,
            &handler.feedback().to_bytes(),
        );
    }
}

fn read_indirect<H: DriverHandler>(
    address: u16,
    registered: bool,
    handler: &H,
    data: &mut PacketBuf,
) {
    let Some(map) = handler.indirect() else {
        return;
    };
    for (at, place) in (address..).zip(data.iter_mut()) {
        *place = match map.target_of(at) {
            Some(target) => table_byte(target, registered, handler),
            None => map.address_byte(at),
        };
    }
}

/// One byte of the X-series part of the table.
fn table_byte<H: DriverHandler>(address: u16, registered: bool, handler: &H) -> u8 {
    let holds = |at: u16, len: u8| address >= at && address < at.saturating_add(u16::from(len));
    let Some(info) = TABLE.iter().find(|info| holds(info.address, info.len)) else {
        return 0;
    };
    let value = match info.register {
        Register::RegisteredInstruction => i32::from(registered),
        other => handler.read(other),
    };
    let offset = usize::from(address.saturating_sub(info.address));
    value.to_le_bytes().get(offset).copied().unwrap_or(0)
}

/// Copies what of `bytes` (at `at`) lies inside `data` (at `address`).
fn overlay(data: &mut [u8], address: u16, at: u16, bytes: &[u8]) {
    for (index, byte) in bytes.iter().enumerate() {
        let place = usize::from(at)
            .saturating_add(index)
            .checked_sub(usize::from(address));
        if let Some(place) = place.and_then(|place| data.get_mut(place)) {
            *place = *byte;
        }
    }
}

/// Whole registers one after the other; all are checked against the table before the first is written.
///
/// # Errors
/// What the table or the driver refuses. Of a refusal by the table nothing was written.
pub(super) fn write<H: DriverHandler>(
    address: u16,
    bytes: &[u8],
    handler: &mut H,
) -> Result<(), StatusError> {
    match handler.indirect().copied() {
        Some(map) if address >= map.start() && address < map.data() => {
            write_targets(&map, address, bytes, handler)
        }
        Some(map) if address >= map.data() && address < map.end() => {
            write_through(&map, address, bytes, handler)
        }
        _ => {
            check(address, bytes, handler)?;
            each_register(address, bytes, |register, value| {
                handler.write(register, value)
            })
        }
    }
}

/// Whether [`write`] would be refused by the table: what a Reg Write is asked.
///
/// # Errors
/// As [`write`].
pub(super) fn check<H: DriverHandler>(
    address: u16,
    bytes: &[u8],
    handler: &H,
) -> Result<(), StatusError> {
    if let Some(map) = handler.indirect()
        && address >= map.start()
        && address < map.end()
    {
        return Ok(());
    }
    let own = handler.indirect().is_none();
    let torque = handler.read(Register::TorqueEnable) != 0;
    each_register(address, bytes, |register, value| {
        let info = register.info();
        match info.access {
            _ if info.address >= OWN_START && !own => Err(StatusError::Access),
            Access::Read => Err(StatusError::Access),
            Access::Eeprom if torque => Err(StatusError::Access),
            _ if value < info.min || value > info.max => Err(StatusError::DataRange),
            _ => Ok(()),
        }
    })
}

fn write_targets<H: DriverHandler>(
    map: &Indirect,
    address: u16,
    bytes: &[u8],
    handler: &mut H,
) -> Result<(), StatusError> {
    let whole = bytes.len().is_multiple_of(2) && (address - map.start()).is_multiple_of(2);
    if !whole || bytes.is_empty() {
        return Err(StatusError::DataLength);
    }
    let mut next = *map;
    for (at, pair) in (address..).step_by(2).zip(bytes.chunks_exact(2)) {
        let target = pair
            .first_chunk::<2>()
            .map_or(0, |pair| u16::from_le_bytes(*pair));
        if !next.set(at, target) {
            return Err(StatusError::DataRange);
        }
    }
    handler.set_indirect(next);
    Ok(())
}

/// A write to the indirect data: every run of neighbouring targets is a write of its own.
fn write_through<H: DriverHandler>(
    map: &Indirect,
    address: u16,
    bytes: &[u8],
    handler: &mut H,
) -> Result<(), StatusError> {
    let mut at = address;
    let mut rest = bytes;
    for _ in 0..MAX_RUNS {
        let Some(first) = map.target_of(at).filter(|_| !rest.is_empty()) else {
            break;
        };
        let neighbours = (0..rest.len() as u16)
            .take_while(|k| map.target_of(at.saturating_add(*k)) == first.checked_add(*k));
        let len = neighbours.count().max(1);
        let (run, after) = rest.split_at_checked(len).ok_or(StatusError::DataLength)?;
        // A place that stands for itself is a place to keep a byte; ours keeps none.
        if first < map.start() {
            check(first, run, handler)?;
            each_register(first, run, |register, value| handler.write(register, value))?;
        }
        at = at.saturating_add(len as u16);
        rest = after;
    }
    if rest.is_empty() {
        Ok(())
    } else {
        Err(StatusError::Access)
    }
}

fn each_register(
    address: u16,
    bytes: &[u8],
    mut visit: impl FnMut(Register, i32) -> Result<(), StatusError>,
) -> Result<(), StatusError> {
    if bytes.is_empty() {
        return Err(StatusError::DataLength);
    }
    let mut at = address;
    let mut rest = bytes;
    // Every pass takes at least one byte.
    while !rest.is_empty() {
        let register = Register::at(at).ok_or(StatusError::Access)?;
        let (value, after) = rest
            .split_at_checked(usize::from(register.size()))
            .ok_or(StatusError::DataLength)?;
        visit(register, register.value_of(value))?;
        at = at.saturating_add(register.size());
        rest = after;
    }
    Ok(())
}
