//! Requests of the module to drivers of any profile.

use heapless::Vec;

use super::feetech;
use super::field::Field;
use super::master::{Answers, MAX_DRIVERS, Request};
use super::packet::BROADCAST;
use super::packet::{Builder, Instruction, PacketBuf, TooLong};
use super::profile::{Framing, ProfileInfo};

impl ProfileInfo {
    /// Is this driver there? Dynamixel drivers answer with model number and version, Feetech ones with nothing more.
    ///
    /// # Errors
    /// [`TooLong`]; not for a ping.
    pub fn ping(&self, id: u8) -> Result<Request, TooLong> {
        match self.framing {
            Framing::Dynamixel2 => Request::ping(id),
            Framing::Feetech => one(id, feetech::Instruction::Ping, &[], 0),
        }
    }

    /// Reads bytes of one driver.
    ///
    /// # Errors
    /// [`TooLong`] when the answer would be.
    pub fn read(&self, id: u8, address: u16, len: u16) -> Result<Request, TooLong> {
        match self.framing {
            Framing::Dynamixel2 => Request::read(id, address, len),
            Framing::Feetech => {
                let range = [byte(address)?, byte(len)?];
                one(id, feetech::Instruction::Read, &[&range], len)
            }
        }
    }

    /// Writes bytes of one driver.
    ///
    /// # Errors
    /// [`TooLong`] for more than a packet.
    pub fn write(&self, id: u8, address: u16, bytes: &[u8]) -> Result<Request, TooLong> {
        match self.framing {
            Framing::Dynamixel2 => {
                let builder = Builder::new(id, Instruction::Write)
                    .params(&address.to_le_bytes())
                    .params(bytes);
                let ids = Vec::from_slice(&[id]).map_err(|_| TooLong)?;
                let packet = builder.finish()?;
                Request::of_packet(packet, self.framing, Answers::Each, ids, 0)
            }
            Framing::Feetech => one(
                id,
                feetech::Instruction::Write,
                &[&[byte(address)?], bytes],
                0,
            ),
        }
    }

    /// Reads a number of one driver.
    ///
    /// # Errors
    /// [`TooLong`]; not for a number.
    pub fn read_field(&self, id: u8, field: &Field) -> Result<Request, TooLong> {
        self.read(id, field.address, u16::from(field.len))
    }

    /// The cyclic read. Of a profile without Sync Read `ids` must hold one id.
    ///
    /// # Errors
    /// [`TooLong`] for more ids than one request reads.
    pub fn read_feedback(&self, ids: &[u8]) -> Result<Request, TooLong> {
        match (self.framing, ids) {
            (_, [id]) if !self.sync_read => self.read(*id, self.feedback, self.feedback_len),
            _ if !self.sync_read => Err(TooLong),
            (Framing::Dynamixel2, ids) => Request::sync_read(self.feedback, self.feedback_len, ids),
            (Framing::Feetech, ids) => {
                let range = [byte(self.feedback)?, byte(self.feedback_len)?];
                let parts = [&range[..], ids];
                let expected = Vec::from_slice(ids).map_err(|_| TooLong)?;
                let packet = framed(BROADCAST, feetech::Instruction::SyncRead, &parts)?;
                let len = self.feedback_len;
                Request::of_packet(packet, self.framing, Answers::Each, expected, len)
            }
        }
    }

    /// Writes one number of several drivers, each its own value. Nobody answers.
    ///
    /// # Errors
    /// [`TooLong`] for more drivers than fit a packet.
    pub fn sync_write(&self, field: &Field, values: &[(u8, i32)]) -> Result<Request, TooLong> {
        let len = usize::from(field.len).min(4);
        let mut entries: Vec<u8, { MAX_DRIVERS * 5 }> = Vec::new();
        for (id, value) in values {
            let bytes = field.bytes_of(*value);
            entries.push(*id).map_err(|_| TooLong)?;
            let bytes = bytes.get(..len).unwrap_or(&[]);
            entries.extend_from_slice(bytes).map_err(|_| TooLong)?;
        }
        let packet = match self.framing {
            Framing::Dynamixel2 => Builder::new(BROADCAST, Instruction::SyncWrite)
                .params(&field.address.to_le_bytes())
                .params(&u16::from(field.len).to_le_bytes())
                .params(&entries)
                .finish()?,
            Framing::Feetech => {
                let head = [byte(field.address)?, field.len];
                let parts = [&head[..], &entries];
                framed(BROADCAST, feetech::Instruction::SyncWrite, &parts)?
            }
        };
        Request::of_packet(packet, self.framing, Answers::None, Vec::new(), 0)
    }

    /// Set-points, urad in the drivers' frames. Who cannot take his is left out: check [`ProfileInfo::goal_counts`] before.
    ///
    /// # Errors
    /// As [`ProfileInfo::sync_write`].
    pub fn set_points(&self, goals_urad: &[(u8, i32)]) -> Result<Request, TooLong> {
        let mut counts: Vec<(u8, i32), MAX_DRIVERS> = Vec::new();
        for (id, angle_urad) in goals_urad {
            if let Some(count) = self.goal_counts(*angle_urad) {
                counts.push((*id, count)).map_err(|_| TooLong)?;
            }
        }
        self.sync_write(&self.goal, &counts)
    }
}

/// Feetech addresses and lengths are bytes.
fn byte(number: u16) -> Result<u8, TooLong> {
    u8::try_from(number).map_err(|_| TooLong)
}

fn framed(
    id: u8,
    instruction: feetech::Instruction,
    parts: &[&[u8]],
) -> Result<PacketBuf, TooLong> {
    let packet = feetech::packet(id, instruction as u8, parts)?;
    PacketBuf::from_slice(&packet).map_err(|_| TooLong)
}

/// A Feetech instruction to one driver, which answers with `len` bytes.
fn one(
    id: u8,
    instruction: feetech::Instruction,
    parts: &[&[u8]],
    len: u16,
) -> Result<Request, TooLong> {
    let ids = Vec::from_slice(&[id]).map_err(|_| TooLong)?;
    let packet = framed(id, instruction, parts)?;
    Request::of_packet(packet, Framing::Feetech, Answers::Each, ids, len)
}
