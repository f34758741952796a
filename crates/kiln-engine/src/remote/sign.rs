//! Signed records: ed25519 (RFC 8032), so that who may write to the remote need not be who is trusted.

use std::fmt;
use std::str::FromStr;

use crate::hash::{ContentHash, NotADigest};

/// A key whose records are trusted: 32 bytes, written as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct PublicKey(pub [u8; 32]);

/// The secret of one who signs: 32 random bytes, written as 64 hexadecimal digits.
#[derive(Clone, PartialEq, Eq)]
pub struct SigningKey([u8; 32]);

impl fmt::Display for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&ContentHash(self.0).hex())
    }
}

impl fmt::Debug for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PublicKey({self})")
    }
}

impl fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SigningKey(secret)")
    }
}

impl FromStr for PublicKey {
    type Err = NotADigest;

    fn from_str(text: &str) -> Result<PublicKey, NotADigest> {
        text.trim().parse::<ContentHash>().map(|bytes| PublicKey(bytes.0))
    }
}

impl FromStr for SigningKey {
    type Err = NotADigest;

    fn from_str(text: &str) -> Result<SigningKey, NotADigest> {
        text.trim().parse::<ContentHash>().map(|bytes| SigningKey(bytes.0))
    }
}

#[cfg(feature = "remote")]
impl SigningKey {
    /// The key that others trust.
    pub fn public(&self) -> PublicKey {
        PublicKey(ed25519_dalek::SigningKey::from_bytes(&self.0).verifying_key().to_bytes())
    }

    pub(super) fn sign(&self, message: &[u8]) -> [u8; 64] {
        use ed25519_dalek::Signer;
        ed25519_dalek::SigningKey::from_bytes(&self.0).sign(message).to_bytes()
    }
}

#[cfg(feature = "remote")]
impl PublicKey {
    /// Strictly: no key or signature of small order, no second form of one signature.
    pub(super) fn verifies(&self, message: &[u8], signature: &[u8]) -> bool {
        let key = ed25519_dalek::VerifyingKey::from_bytes(&self.0);
        let signature = ed25519_dalek::Signature::from_slice(signature);
        key.ok().zip(signature.ok()).is_some_and(|(key, signature)| key.verify_strict(message, &signature).is_ok())
    }
}

// Without the feature nothing can be signed and nothing is trusted; `RemoteOptions` refuses keys.
#[cfg(not(feature = "remote"))]
impl SigningKey {
    pub(super) fn public(&self) -> PublicKey {
        PublicKey([0; 32])
    }

    pub(super) fn sign(&self, _message: &[u8]) -> [u8; 64] {
        [0; 64]
    }
}

#[cfg(not(feature = "remote"))]
impl PublicKey {
    pub(super) fn verifies(&self, _message: &[u8], _signature: &[u8]) -> bool {
        false
    }
}
