//! The first byte says which entry, the rest are its arguments.

#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../../trackrs/tests/fuzz/mod.rs"]
mod fuzz;

fuzz_target!(|bytes: &[u8]| {
    if let Some((&which, rest)) = bytes.split_first() {
        let (_, entry) = fuzz::ENTRIES[usize::from(which) % fuzz::ENTRIES.len()];
        entry(&mut fuzz::Source::new(rest));
    }
});
