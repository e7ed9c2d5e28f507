//! Who may move the robot: challenge, tag, key.
//!
//! The module hands out a nonce ([`super::FromModule::Challenge`]). Every order that can cause or prepare motion ends with a tag:
//! the first 16 bytes of HMAC-SHA-256 over the domain, the nonce, the message type and the payload without the tag. An accepted tag consumes its nonce.
//! STOP needs no tag. In the other direction [`super::FromModule::State`] carries a tag over a nonce of the host: proof that the answer is the module's. The key is set over a wire port only, never over radio.

use hmac::{Hmac, KeyInit, Mac};
use serde::{Deserialize, Serialize};
use sha2::Sha256;

use super::message::FromModule;

/// Bytes of the shared key.
pub const KEY_LEN: usize = 32;
/// Bytes of a challenge.
pub const NONCE_LEN: usize = 16;
/// Bytes of a tag: 128 bit.
pub const TAG_LEN: usize = 16;

/// Separates our tags from any other use of the same key, and from later versions of this scheme.
const ORDER: &[u8] = b"rb-link/1 order\0";
/// The same for what the module proves to the host.
const STATE: &[u8] = b"rb-link/1 state\0";

/// The per-robot key. Its `Debug` does not show it.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Key(pub [u8; KEY_LEN]);

impl core::fmt::Debug for Key {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Key(..)")
    }
}

/// A challenge, good for one accepted order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Nonce(pub [u8; NONCE_LEN]);

/// Proof that the sender knows the key. [`Tag::NONE`] where no key is set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tag(pub [u8; TAG_LEN]);

impl Tag {
    /// All zero: an order before it is signed, or to a module without a key on a wire port.
    pub const NONE: Self = Self([0; TAG_LEN]);
}

impl Key {
    fn mac(
        &self,
        domain: &[u8],
        nonce: &Nonce,
        kind: u8,
        payload_without_tag: &[u8],
    ) -> Hmac<Sha256> {
        let mut mac = <Hmac<Sha256> as KeyInit>::new(&self.block().into());
        mac.update(domain);
        mac.update(&nonce.0);
        mac.update(&[kind]);
        mac.update(payload_without_tag);
        mac
    }

    /// RFC 2104 pads a short key with zeros to the hash's block, 64 bytes: doing it here spares the fallible constructor.
    fn block(&self) -> [u8; 64] {
        let mut block = [0; 64];
        for (to, from) in block.iter_mut().zip(self.0.iter()) {
            *to = *from;
        }
        block
    }

    /// Tag of one order.
    #[must_use]
    pub fn sign(&self, nonce: &Nonce, kind: u8, payload_without_tag: &[u8]) -> Tag {
        truncated(self.mac(ORDER, nonce, kind, payload_without_tag))
    }

    /// Tag of the module's answer to a host's nonce.
    #[must_use]
    pub fn sign_state(&self, nonce: &Nonce, kind: u8, payload_without_tag: &[u8]) -> Tag {
        truncated(self.mac(STATE, nonce, kind, payload_without_tag))
    }

    /// Whether the tag is right. Takes the same time whichever byte differs.
    #[must_use]
    pub fn verify(&self, nonce: &Nonce, kind: u8, payload_without_tag: &[u8], tag: &Tag) -> bool {
        self.mac(ORDER, nonce, kind, payload_without_tag)
            .verify_truncated_left(&tag.0)
            .is_ok()
    }

    /// Whether a message of the module answers this nonce and was signed with this key; of messages without a tag, never.
    #[must_use]
    pub fn proves(&self, nonce: &Nonce, message: &FromModule) -> bool {
        let FromModule::State { tag, .. } = message else {
            return false;
        };
        let mut buffer = [0; MAX_STATE];
        let Ok(used) = postcard::to_slice(message, &mut buffer) else {
            return false;
        };
        let Some((&[kind, ref payload @ ..], _)) = used.split_last_chunk::<TAG_LEN>() else {
            return false;
        };
        self.mac(STATE, nonce, kind, payload)
            .verify_truncated_left(&tag.0)
            .is_ok()
    }
}

/// Largest [`FromModule::State`] with its type byte: state, a u64 as varint, tag.
const MAX_STATE: usize = 1 + 1 + 10 + TAG_LEN;

fn truncated(mac: Hmac<Sha256>) -> Tag {
    let full = mac.finalize().into_bytes();
    let mut tag = Tag::NONE;
    for (to, from) in tag.0.iter_mut().zip(full.iter()) {
        *to = *from;
    }
    tag
}
