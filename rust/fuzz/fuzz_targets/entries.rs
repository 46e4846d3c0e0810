//! The first byte says which entry, the rest are its arguments; `TRACKRS_FUZZ_ENTRY` names one that gets all of them.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;

#[path = "../../trackrs/tests/fuzz/mod.rs"]
mod fuzz;

static ENTRIES: LazyLock<Vec<fuzz::Entry>> = LazyLock::new(|| {
    let wanted = std::env::var("TRACKRS_FUZZ_ENTRY").ok();
    let entries: Vec<_> = fuzz::ENTRIES
        .iter()
        .filter(|(name, _)| wanted.as_deref().is_none_or(|wanted| wanted == *name))
        .map(|&(_, entry)| entry)
        .collect();
    assert!(!entries.is_empty(), "TRACKRS_FUZZ_ENTRY names no entry");
    entries
});

fuzz_target!(|bytes: &[u8]| {
    if let Some((&which, rest)) = bytes.split_first() {
        ENTRIES[usize::from(which) % ENTRIES.len()](&mut fuzz::Source::new(rest));
    }
});
