//! Instructions that name several drivers: Sync and Bulk Read and Write. Driver side.

use super::access::write;
use super::server::DriverHandler;

/// What a read of several drivers asks of each.
pub(super) enum Group<'a> {
    /// The same of all.
    Sync {
        address: u16,
        len: u16,
        ids: &'a [u8],
    },
    /// Id, address and length of each, five bytes.
    Bulk(&'a [u8]),
}

impl<'a> Group<'a> {
    /// Of a Sync Read.
    pub(super) fn sync(params: &'a [u8]) -> Option<Self> {
        let (&[a0, a1, l0, l1], ids) = params.split_first_chunk::<4>()?;
        Some(Self::Sync {
            address: u16::from_le_bytes([a0, a1]),
            len: u16::from_le_bytes([l0, l1]),
            ids,
        })
    }

    /// Of a Bulk Read.
    pub(super) fn bulk(params: &'a [u8]) -> Self {
        Self::Bulk(params)
    }

    /// Number of entries.
    pub(super) fn count(&self) -> usize {
        match self {
            Self::Sync { ids, .. } => ids.len(),
            Self::Bulk(params) => params.len() / 5,
        }
    }

    /// Id, address and length of the entry.
    pub(super) fn get(&self, index: usize) -> Option<(u8, u16, u16)> {
        match self {
            Self::Sync { address, len, ids } => Some((*ids.get(index)?, *address, *len)),
            Self::Bulk(params) => {
                let entry = params.get(index.checked_mul(5)?..)?;
                let &[id, a0, a1, l0, l1] = entry.first_chunk::<5>()?;
                Some((
                    id,
                    u16::from_le_bytes([a0, a1]),
                    u16::from_le_bytes([l0, l1]),
                ))
            }
        }
    }

    /// First entry of a driver.
    pub(super) fn place(&self, own: u8) -> Option<usize> {
        (0..self.count()).find(|index| self.get(*index).is_some_and(|(id, ..)| id == own))
    }
}

/// The entries of a Sync Write that name this driver.
pub(super) fn sync_write<H: DriverHandler>(params: &[u8], own: u8, now_ns: u64, handler: &mut H) {
    let Some((&[a0, a1, l0, l1], entries)) = params.split_first_chunk::<4>() else {
        return;
    };
    let len = usize::from(u16::from_le_bytes([l0, l1]));
    for entry in entries.chunks_exact(len.saturating_add(1)) {
        if let Some((id, bytes)) = entry.split_first()
            && *id == own
        {
            handler.latch(now_ns);
            // A Sync Write is never answered; the refusal shows in the status bits.
            let _ = write(u16::from_le_bytes([a0, a1]), bytes, handler);
        }
    }
}

/// The entries of a Bulk Write that name this driver.
pub(super) fn bulk_write<H: DriverHandler>(params: &[u8], own: u8, now_ns: u64, handler: &mut H) {
    let mut rest = params;
    // Every pass takes at least five bytes.
    while let Some((&[id, a0, a1, l0, l1], after)) = rest.split_first_chunk::<5>() {
        let len = usize::from(u16::from_le_bytes([l0, l1]));
        let Some((bytes, next)) = after.split_at_checked(len) else {
            return;
        };
        rest = next;
        if id == own {
            handler.latch(now_ns);
            // As of a Sync Write.
            let _ = write(u16::from_le_bytes([a0, a1]), bytes, handler);
        }
    }
}
