//! What the specification of Cryptomatte (Friedman and Jones 2015; version 1.2.0) fixes: ids of names, and attributes of a file.

use serde_json::{Map, Value};

/// Pairs of an id and its coverage in each pixel, ordered by coverage.
pub(super) const RANKS: usize = 6;

/// The id of a name: its hash, with a bit of the exponent turned where the `f32` of these bits would be no normal number.
pub(super) fn id(name: &str) -> u32 {
    let hash = murmur3(name.as_bytes());
    match hash >> 23 & 0xff {
        0 | 0xff => hash ^ 1 << 23,
        _ => hash,
    }
}

/// MurmurHash3_x86_32 (Appleby 2011) with the seed 0.
fn murmur3(bytes: &[u8]) -> u32 {
    let scramble = |block: u32| {
        let block = block.wrapping_mul(0xcc9e_2d51).rotate_left(15);
        block.wrapping_mul(0x1b87_3593)
    };
    let (blocks, rest) = bytes.as_chunks::<4>();
    let mut hash = blocks.iter().fold(0_u32, |hash, block| {
        let mixed = (hash ^ scramble(u32::from_le_bytes(*block))).rotate_left(13);
        mixed.wrapping_mul(5).wrapping_add(0xe654_6b64)
    });
    let last = rest.iter().rev().fold(0, |last, byte| last << 8 | u32::from(*byte));
    hash ^= scramble(last) ^ bytes.len() as u32;
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

/// The attributes of a layer of the name `layer` whose ids are those of `names`. The manifest is JSON, in which a name stands once.
pub(super) fn attributes<'n>(layer: &str, names: impl Iterator<Item = &'n str>) -> Vec<(String, String)> {
    let hexadecimal = |name: &str| format!("{:08x}", id(name));
    let manifest: Map<String, Value> = names.map(|name| (name.to_owned(), hexadecimal(name).into())).collect();
    let values = [
        ("name", layer.to_owned()),
        ("hash", "MurmurHash3_32".to_owned()),
        ("conversion", "uint32_to_float32".to_owned()),
        ("manifest", Value::Object(manifest).to_string()),
    ];
    let key = &hexadecimal(layer)[..7];
    values
        .map(|(attribute, value)| (format!("cryptomatte/{key}/{attribute}"), value))
        .into()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of all lengths of a last block; from the Python package `mmh3`.
    #[test]
    fn hashes_are_those_of_murmur_hash_3() {
        for (text, hash) in [
            ("", 0),
            ("a", 0x3c25_69b2),
            ("aa", 0x3710_91a9),
            ("abc", 0xb3dd_93fa),
            ("test", 0xba6b_d213),
            ("hello", 0x248b_fa47),
            ("Hello, world!", 0xc036_3e43),
            ("The quick brown fox jumps over the lazy dog", 0x2e4f_f723),
        ] {
            assert_eq!(murmur3(text.as_bytes()), hash, "{text}");
        }
    }

    #[test]
    fn no_id_is_an_unusual_number() {
        assert_eq!(id(""), 1 << 23);
        let mut turned = 0;
        for number in 0..5_000 {
            let name = format!("object {number}");
            assert!(f32::from_bits(id(&name)).is_normal(), "{name}");
            turned += u32::from(id(&name) != murmur3(name.as_bytes()));
        }
        assert!((15..100).contains(&turned), "about two in 256: {turned}");
    }

    #[test]
    fn a_layer_has_four_attributes() {
        let found = attributes("CryptoObject", ["b", "a\"\u{e4}", "b"].into_iter());
        let names: Vec<&str> = found.iter().map(|(name, _)| &name[19..]).collect();
        assert_eq!(names, ["/name", "/hash", "/conversion", "/manifest"]);
        assert!(
            found
                .iter()
                .all(|(name, _)| name.starts_with("cryptomatte/") && name.len() < 32)
        );
        let manifest: Map<String, Value> = serde_json::from_str(&found[3].1).unwrap();
        let expected = ["b", "a\"\u{e4}"].map(|name| (name.to_owned(), Value::from(format!("{:08x}", id(name)))));
        assert_eq!(manifest, Map::from_iter(expected));
    }
}
