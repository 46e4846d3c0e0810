//! Saved state: versioned, checksummed bytes that can hold data and nothing else.
//!
//! | bytes | content                                                          |
//! |-------|------------------------------------------------------------------|
//! | 0..6  | `TRKRS\0`                                                        |
//! | 6..8  | format version, u16 little-endian                                |
//! | 8..n−4 | MessagePack map of the saved value, fields by name              |
//! | n−4..n | CRC-32 (IEEE) of everything before, u32 little-endian           |
//!
//! Fields are saved by name, so that a later version can read an earlier one's bytes.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::{Error, Result};

const MAGIC: &[u8; 6] = b"TRKRS\0";
const VERSION: u16 = 1;

/// Saves a value.
pub fn to_bytes<T: Serialize>(value: &T) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&VERSION.to_le_bytes());
    let payload = rmp_serde::to_vec_named(value).map_err(|error| Error::CannotSave {
        reason: error.to_string(),
    })?;
    bytes.extend_from_slice(&payload);
    let checksum = crc32fast::hash(&bytes);
    bytes.extend_from_slice(&checksum.to_le_bytes());
    Ok(bytes)
}

/// Reads a value back. Truncated, altered or foreign bytes are an error.
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T> {
    let corrupt = |reason: String| Error::CorruptState { reason };
    let Some((body, checksum)) = bytes.split_last_chunk::<4>() else {
        return Err(corrupt("it is too short".into()));
    };
    let Some(rest) = body.strip_prefix(MAGIC) else {
        return Err(corrupt("it does not begin as a trackrs state does".into()));
    };
    if crc32fast::hash(body) != u32::from_le_bytes(*checksum) {
        return Err(corrupt("its checksum does not fit".into()));
    }
    let Some((version, payload)) = rest.split_first_chunk::<2>() else {
        return Err(corrupt("it is too short".into()));
    };
    let version = u16::from_le_bytes(*version);
    if version != VERSION {
        return Err(corrupt(format!(
            "it has format version {version}, this trackrs reads {VERSION}"
        )));
    }
    rmp_serde::from_slice(payload).map_err(|error| corrupt(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_return_bit_for_bit() {
        let value = vec![0.1, -0.0, f64::MIN_POSITIVE / 8.0, 1e300, std::f64::consts::PI];
        let back: Vec<f64> = from_bytes(&to_bytes(&value).unwrap()).unwrap();
        assert!(value.iter().zip(&back).all(|(a, b)| a.to_bits() == b.to_bits()));
    }

    #[test]
    fn every_flipped_bit_and_every_cut_is_noticed() {
        let bytes = to_bytes(&vec![1.0, 2.0, 3.0]).unwrap();
        for i in 0..bytes.len() {
            for bit in 0..8 {
                let mut altered = bytes.clone();
                altered[i] ^= 1 << bit;
                assert!(matches!(
                    from_bytes::<Vec<f64>>(&altered),
                    Err(Error::CorruptState { .. })
                ));
            }
            assert!(matches!(
                from_bytes::<Vec<f64>>(&bytes[..i]),
                Err(Error::CorruptState { .. })
            ));
        }
    }
}
